within Twinproof.Effects.Rotational;
model CubicSpring "Restoring torque that grows with the cube of angle"
  extends Twinproof.Interfaces.RotationalEffect;

  parameter Real k3(unit = "N.m/rad3", nominal = 1) = 0 "Cubic stiffness, zero torque at phi = 0";
equation
  flange.tau = k3 * phi^3;

  annotation(Documentation(info = "<html>
  <p>Torque <code>k3*phi^3</code> towards <code>phi = 0</code>: the hardening (positive) or
  softening (negative) part of a spring.</p>
  <h4>Reference</h4>
  <ul>
  <li>A. H. Nayfeh, D. T. Mook, <em>Nonlinear Oscillations</em> (1979) (the Duffing
  oscillator)</li>
  </ul>
  </html>"));
end CubicSpring;
