within Twinproof.Effects.Translational;
model RollingResistance "Friction force of rolling guides, between dry and viscous"
  extends Twinproof.Interfaces.TranslationalEffect;

  parameter Real f_r(unit = "N", min = 0, nominal = 5) = 0 "Friction force at 0.1 m/s";
  parameter Real v_r(unit = "m/s", min = 1e-4, nominal = 0.1) = 0.1 "Speed at which f_r is stated"
    annotation(__twinproof(known = true));
  parameter Real v_0(unit = "m/s", min = 1e-6, nominal = 1e-3) = 1e-3
    "Speed below which the law is straightened" annotation(__twinproof(known = true));
equation
  flange.f = f_r * (v / v_r) * ((v^2 + v_0^2) / v_r^2)^(-1 / 6);

  annotation(Documentation(info = "<html>
  <p>Force proportional to <code>|v|^(2/3)*sign(v)</code>: the lubricant in a rolling contact is
  sheared in a film that thickens with speed. A positive parameter opposes motion. The slope at
  standstill, infinite in the textbook, is bounded by <code>v_0</code>, a numerical width that is
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
