within Twinproof.Effects.Rotational;
model FlexibleMode "Second inertia that hangs on by a damped spring"
  extends Twinproof.Interfaces.RotationalEffect;

  parameter Real J_f(unit = "kg.m2", min = 0, nominal = 0.01) = 0 "Inertia that vibrates";
  parameter Real f_n(unit = "Hz", min = 1, max = 100, nominal = 10) = 10
    "Frequency at which it would vibrate on a fixed flange";
  parameter Real zeta(unit = "1", min = 1e-3, nominal = 0.05) = 0.05 "Damping ratio"
    annotation(__twinproof(known = true));
  parameter Real x_start(unit = "rad") = 0 "Twist at the start";
  parameter Real w_f_start(unit = "rad/s") = 0 "Speed of the second inertia at the start";
  Real x(unit = "rad", start = x_start, fixed = true) "Twist of the spring";
  Real w_f(unit = "rad/s", start = w_f_start, fixed = true) "Speed of the second inertia";
protected
  final parameter Real omega_n(unit = "rad/s") = 2 * 3.14159265358979 * f_n "Its angular frequency";
equation
  der(x) = w - w_f;
  der(w_f) = omega_n^2 * x + 2 * zeta * omega_n * (w - w_f);
  flange.tau = J_f * (omega_n^2 * x + 2 * zeta * omega_n * (w - w_f));

  annotation(__twinproof(search = false), Documentation(info = "<html>
  <p>The load behind a flexible shaft, a tank that sloshes, an antenna. The spring is written by
  its frequency, so that <code>J_f = 0</code> is exactly nothing and a small inertia has its right
  first-order effect. Slow motion only shows the sum of the inertias; the resonance tells them
  apart.</p>
  <p>It gives energy back as it vibrates and loses it over a cycle.</p>
  <h4>Reference</h4>
  <ul>
  <li>L. Meirovitch, <em>Fundamentals of Vibrations</em> (2001)</li>
  </ul>
  </html>"));
end FlexibleMode;
