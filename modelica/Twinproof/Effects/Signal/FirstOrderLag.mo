within Twinproof.Effects.Signal;
block FirstOrderLag "First-order low-pass"
  extends Twinproof.Interfaces.SignalEffect;

  parameter Real T(unit = "s", min = 0, max = 1, nominal = 0.02) = 0 "Time constant";
  parameter Real T_min(unit = "s", min = 1e-6, nominal = 1e-3) = 1e-3
    "Shortest time constant represented exactly" annotation(__twinproof(known = true));
  parameter Real x_start = 0 "Start of the filtered signal, in the unit of the signal";
  Real x(start = x_start, fixed = true) "Filtered signal, in the unit of the signal";
protected
  final parameter Real T_r(unit = "s") = max(T, T_min) "Time constant of the filter";
equation
  T_r * der(x) = u - x;
  y = u + T / T_r * (x - u);

  annotation(Documentation(info = "<html>
  <p><code>T*der(y) = u - y</code>: the electrical time constant of a motor, the smoothing in
  a sensor.</p>
  <p>Below <code>T_min</code> the block is <code>y = u + (T/T_min)*(x - u)</code>. So it is
  exactly absent at <code>T = 0</code>, nothing is divided by zero, and a small <code>T</code>
  has the right first-order effect <code>-T*der(u)</code>; from <code>T_min</code> on it is
  exact. Set <code>T_min</code> to the sampling interval when that is longer.</p>
  <h4>Reference</h4>
  <ul>
  <li>K. J. &Aring;str&ouml;m, R. M. Murray, <em>Feedback Systems</em> (2008)</li>
  </ul>
  </html>"));
end FirstOrderLag;
