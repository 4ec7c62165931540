within Twinproof.Interfaces;
connector RotationalFlange "Shaft end at which torques act"
  Real phi(unit = "rad") "Angle";
  flow Real tau(unit = "N.m") "Torque into the component";

  annotation(Documentation(info = "<html>
  <p>Has the shape of the flanges of <code>Modelica.Mechanics.Rotational</code> and can be
  connected to them.</p>
  <h4>Reference</h4>
  <ul>
  <li>Modelica Association, <em>Modelica Standard Library</em>, version 4</li>
  </ul>
  </html>"));
end RotationalFlange;
