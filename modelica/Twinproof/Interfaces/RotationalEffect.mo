within Twinproof.Interfaces;
partial model RotationalEffect "A torque that depends on the motion of one flange"
  RotationalFlange flange "Connect to the flange of a point";
  Real phi(unit = "rad") "Angle";
  Real w(unit = "rad/s") "Angular velocity";
equation
  phi = flange.phi;
  w = der(phi);

  annotation(Documentation(info = "<html>
  <p>A class that extends this one gives <code>flange.tau</code>, the torque that the machine
  spends on the effect: <code>+d*w</code> for a friction that opposes motion.</p>
  <h4>Reference</h4>
  <ul>
  <li>Modelica Association, <em>Modelica Standard Library</em>, version 4</li>
  </ul>
  </html>"));
end RotationalEffect;
