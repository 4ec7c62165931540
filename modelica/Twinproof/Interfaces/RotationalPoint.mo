within Twinproof.Interfaces;
model RotationalPoint "Place on a plant where torques can be attached"
  RotationalFlange flange "Connect effects here";
  input Real phi(unit = "rad") "Angle of this place, given by the plant";
  Real tau(unit = "N.m") "Sum of the attached torques along phi, for the equation of motion";
equation
  flange.phi = phi;
  flange.tau = tau;

  annotation(Documentation(info = "<html>
  <p>A plant declares a point, sets its <code>phi</code> and adds its <code>tau</code> to the
  equation of motion. With nothing attached <code>tau</code> is zero. The flange sits inside a
  component, because a class that extends the plant can connect to it there; a flange declared in
  the plant itself would be a connector to the outside and could not be connected from within.</p>
  <h4>Reference</h4>
  <ul>
  <li>Modelica Association, <em>Modelica Standard Library</em>, version 4</li>
  </ul>
  </html>"));
end RotationalPoint;
