within Twinproof.Effects.Rotational;
model RollingResistance "Friction torque of rolling bearings, between dry and viscous"
  extends Twinproof.Interfaces.RotationalEffect;

  parameter Real tau_r(unit = "N.m", min = 0, nominal = 0.05) = 0 "Friction torque at 1 rad/s";
  parameter Real w_r(unit = "rad/s", min = 1e-3, nominal = 1) = 1 "Speed at which tau_r is stated"
    annotation(__twinproof(known = true));
  parameter Real w_0(unit = "rad/s", min = 1e-4, nominal = 0.05) = 0.05
    "Speed below which the law is straightened" annotation(__twinproof(known = true));
equation
  flange.tau = tau_r * (w / w_r) * ((w^2 + w_0^2) / w_r^2)^(-1 / 6);

  annotation(Documentation(info = "<html>
  <p>Torque proportional to <code>|w|^(2/3)*sign(w)</code>: the lubricant in a rolling contact is
  sheared in a film that thickens with speed. A positive parameter opposes motion. The slope at
  standstill, infinite in the textbook, is bounded by <code>w_0</code>, a numerical width that is
  not fitted.</p>
  <h4>Reference</h4>
  <ul>
  <li>A. Palmgren, <em>Ball and Roller Bearing Engineering</em>, 3rd ed. (1959) (the
  load-independent moment)</li>
  <li>T. A. Harris, M. N. Kotzalas, <em>Essential Concepts of Bearing Technology</em>, 5th ed.
  (2006)</li>
  </ul>
  </html>"));
end RollingResistance;
