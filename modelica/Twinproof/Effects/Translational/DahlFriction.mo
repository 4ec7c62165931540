within Twinproof.Effects.Translational;
model DahlFriction "Dry friction that gives way like a spring before it slides"
  extends Twinproof.Interfaces.TranslationalEffect;

  parameter Real f_c(unit = "N", min = 0, nominal = 10) = 0 "Friction force while sliding";
  parameter Real s_b(unit = "m", min = 2e-4, max = 0.01, nominal = 1e-3) = 1e-3
    "Distance within which the force turns round";
  parameter Real T_b(unit = "s", min = 1e-5, nominal = 1e-3) = 1e-3
    "Shortest time in which the bristles follow" annotation(__twinproof(known = true));
  parameter Real z_start(unit = "1") = 0 "Start of the bristles' deflection";
  Real z(unit = "1", start = z_start, fixed = true) "Bristles' deflection, from -1 to 1";
equation
  (s_b + T_b * abs(v)) * der(z) = v - abs(v) * z;
  flange.f = f_c * z;

  annotation(__twinproof(search = false), Documentation(info = "<html>
  <p>Force <code>f_c*z</code>, where <code>z</code> approaches the sign of the speed over the
  distance <code>s_b</code>. Below 0.2 mm it cannot be told from <a
  href=\"modelica://Twinproof.Effects.Translational.CoulombFriction\">CoulombFriction</a>, which
  is why the range ends there.</p>
  <p>Over a whole cycle a positive parameter takes energy out; within one the bristles give back
  what they stored. At high speed the bristles would follow within much less than a time step;
  they are given at least <code>T_b</code>, a numerical width that is not fitted.</p>
  <h4>Reference</h4>
  <ul>
  <li>P. R. Dahl, <em>A Solid Friction Model</em>, Aerospace Corporation, TOR-158(3107-18)
  (1968)</li>
  <li>H. Olsson, K. J. &Aring;str&ouml;m, C. Canudas de Wit, M. G&auml;fvert, P. Lischinsky,
  <em>Friction models and friction compensation</em>, European Journal of Control 4 (1998)
  176-195</li>
  </ul>
  </html>"));
end DahlFriction;
