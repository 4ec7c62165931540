within Twinproof.Effects.Translational;
model FlexibleMode "Second mass that hangs on by a damped spring"
  extends Twinproof.Interfaces.TranslationalEffect;

  parameter Real m_f(unit = "kg", min = 0, nominal = 1) = 0 "Mass that vibrates";
  parameter Real f_n(unit = "Hz", min = 1, max = 100, nominal = 10) = 10
    "Frequency at which it would vibrate on a fixed flange";
  parameter Real zeta(unit = "1", min = 1e-3, nominal = 0.05) = 0.05 "Damping ratio"
    annotation(__twinproof(known = true));
  parameter Real x_start(unit = "m") = 0 "Deflection at the start";
  parameter Real v_f_start(unit = "m/s") = 0 "Speed of the second mass at the start";
  Real x(unit = "m", start = x_start, fixed = true) "Deflection of the spring";
  Real v_f(unit = "m/s", start = v_f_start, fixed = true) "Speed of the second mass";
protected
  final parameter Real omega_n(unit = "rad/s") = 2 * 3.14159265358979 * f_n "Its angular frequency";
equation
  der(x) = v - v_f;
  der(v_f) = omega_n^2 * x + 2 * zeta * omega_n * (v - v_f);
  flange.f = m_f * (omega_n^2 * x + 2 * zeta * omega_n * (v - v_f));

  annotation(__twinproof(search = false), Documentation(info = "<html>
  <p>The load behind a flexible beam, a tank that sloshes, a mast. The spring is written by its
  frequency, so that <code>m_f = 0</code> is exactly nothing and a small mass has its right
  first-order effect. Slow motion only shows the sum of the masses; the resonance tells them
  apart.</p>
  <p>It gives energy back as it vibrates and loses it over a cycle.</p>
  <h4>Reference</h4>
  <ul>
  <li>L. Meirovitch, <em>Fundamentals of Vibrations</em> (2001)</li>
  </ul>
  </html>"));
end FlexibleMode;
