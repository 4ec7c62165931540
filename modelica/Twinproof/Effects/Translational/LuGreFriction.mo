within Twinproof.Effects.Translational;
model LuGreFriction "Dry friction with bristles and a higher breakaway: it sticks and slips"
  extends Twinproof.Interfaces.TranslationalEffect;

  parameter Real f_c(unit = "N", min = 0, nominal = 10) = 0 "Friction force while sliding";
  parameter Real v_s(unit = "m/s", min = 2e-3, max = 0.1, nominal = 0.01) = 0.01
    "Stribeck speed, at which 37 % of the excess is left";
  parameter Real r_s(unit = "1", min = 0, nominal = 0.5) = 0.5
    "Excess of breakaway over sliding friction, relative to the latter"
    annotation(__twinproof(known = true));
  parameter Real s_b(unit = "m", min = 1e-6, nominal = 1e-4) = 1e-4
    "Distance within which the force turns round" annotation(__twinproof(known = true));
  parameter Real T_b(unit = "s", min = 1e-5, nominal = 1e-3) = 1e-3
    "Shortest time in which the bristles follow" annotation(__twinproof(known = true));
  parameter Real z_start(unit = "1") = 0 "Start of the bristles' deflection";
  Real z(unit = "1", start = z_start, fixed = true) "Bristles' deflection, 1 while sliding fast";
equation
  (s_b + T_b * abs(v)) * der(z) = v - abs(v) * z / (1 + r_s * exp(-(v / v_s)^2));
  flange.f = f_c * z;

  annotation(__twinproof(search = false), Documentation(info = "<html>
  <p>The model of Canudas de Wit without its micro-damping: in steady sliding the level falls from
  <code>1 + r_s</code> times the Coulomb level at standstill to that level, over the Stribeck
  speed; through standstill it follows the bristles. Add <a
  href=\"modelica://Twinproof.Effects.Translational.ViscousFriction\">ViscousFriction</a> for its
  viscous part.</p>
  <p>Over a whole cycle a positive parameter takes energy out; within one the bristles give back
  what they stored. At high speed the bristles would follow within much less than a time step;
  they are given at least <code>T_b</code>, a numerical width that is not fitted.</p>
  <h4>Reference</h4>
  <ul>
  <li>C. Canudas de Wit, H. Olsson, K. J. &Aring;str&ouml;m, P. Lischinsky, <em>A new model for
  control of systems with friction</em>, IEEE Transactions on Automatic Control 40 (1995)
  419-425</li>
  <li>H. Olsson, K. J. &Aring;str&ouml;m, C. Canudas de Wit, M. G&auml;fvert, P. Lischinsky,
  <em>Friction models and friction compensation</em>, European Journal of Control 4 (1998)
  176-195</li>
  </ul>
  </html>"));
end LuGreFriction;
