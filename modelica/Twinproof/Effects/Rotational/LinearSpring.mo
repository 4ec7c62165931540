within Twinproof.Effects.Rotational;
model LinearSpring "Restoring torque proportional to angle"
  extends Twinproof.Interfaces.RotationalEffect;

  parameter Real k(unit = "N.m/rad", nominal = 1) = 0 "Stiffness, zero torque at phi = 0";
equation
  flange.tau = k * phi;

  annotation(Documentation(info = "<html>
  <p>Torque <code>k*phi</code> towards <code>phi = 0</code>, of a cable, a belt or a flexure.
  A positive parameter pulls back; a negative one is possible (an unbalanced mass, a
  magnet).</p>
  <h4>Reference</h4>
  <ul>
  <li>L. Meirovitch, <em>Fundamentals of Vibrations</em> (2001)</li>
  </ul>
  </html>"));
end LinearSpring;
