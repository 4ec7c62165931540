within Twinproof.Effects.Rotational;
model BoucWenHysteresis "Spring that yields and remembers: hysteresis without a sharp corner"
  extends Twinproof.Interfaces.RotationalEffect;

  parameter Real tau_y(unit = "N.m", min = 0, nominal = 0.2) = 0 "Torque at which it yields";
  parameter Real phi_y(unit = "rad", min = 0.05, max = 2, nominal = 0.2) = 0.2
    "Angle at which the initial stiffness would reach it";
  parameter Real T_b(unit = "s", min = 1e-5, nominal = 1e-3) = 1e-3
    "Shortest time in which the bristles follow" annotation(__twinproof(known = true));
  parameter Real z_start(unit = "1") = 0 "Start of the hysteretic deflection";
  Real z(unit = "1", start = z_start, fixed = true) "Hysteretic deflection, from -1 to 1";
equation
  (phi_y + T_b * abs(w)) * der(z) = w - 0.5 * (abs(w) * z * abs(z) + w * z^2);
  flange.tau = tau_y * z;

  annotation(__twinproof(search = false), Documentation(info = "<html>
  <p>The model of Bouc and Wen with <code>n = 2</code> and <code>beta = gamma</code>, scaled so
  that <code>z</code> ends at one: it loads along a bent curve and unloads along a straight one,
  as a rubber mount, a strain-wave gear or a cable does. A spring beside it is a <a
  href=\"modelica://Twinproof.Effects.Rotational.LinearSpring\">LinearSpring</a>.</p>
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
