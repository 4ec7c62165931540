within Twinproof.Effects.Translational;
model BoucWenHysteresis "Spring that yields and remembers: hysteresis without a sharp corner"
  extends Twinproof.Interfaces.TranslationalEffect;

  parameter Real f_y(unit = "N", min = 0, nominal = 20) = 0 "Force at which it yields";
  parameter Real s_y(unit = "m", min = 1e-3, max = 0.2, nominal = 0.01) = 0.01
    "Distance at which the initial stiffness would reach it";
  parameter Real T_b(unit = "s", min = 1e-5, nominal = 1e-3) = 1e-3
    "Shortest time in which the bristles follow" annotation(__twinproof(known = true));
  parameter Real z_start(unit = "1") = 0 "Start of the hysteretic deflection";
  Real z(unit = "1", start = z_start, fixed = true) "Hysteretic deflection, from -1 to 1";
equation
  (s_y + T_b * abs(v)) * der(z) = v - 0.5 * (abs(v) * z * abs(z) + v * z^2);
  flange.f = f_y * z;

  annotation(__twinproof(search = false), Documentation(info = "<html>
  <p>The model of Bouc and Wen with <code>n = 2</code> and <code>beta = gamma</code>, scaled so
  that <code>z</code> ends at one: it loads along a bent curve and unloads along a straight one,
  as a rubber mount, a strain-wave gear or a cable does. A spring beside it is a <a
  href=\"modelica://Twinproof.Effects.Translational.LinearSpring\">LinearSpring</a>.</p>
  <p>Over a whole cycle a positive parameter takes energy out. At high speed the deflection would
  follow within much less than a time step; it is given at least <code>T_b</code>, a numerical
  width that is not fitted.</p>
  <h4>Reference</h4>
  <ul>
  <li>Y.-K. Wen, <em>Method for random vibration of hysteretic systems</em>, Journal of the
  Engineering Mechanics Division 102 (1976) 249-263</li>
  <li>M. Ismail, F. Ikhouane, J. Rodellar, <em>The hysteresis Bouc-Wen model, a survey</em>,
  Archives of Computational Methods in Engineering 16 (2009) 161-188</li>
  </ul>
  </html>"));
end BoucWenHysteresis;
