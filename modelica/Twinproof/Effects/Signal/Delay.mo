within Twinproof.Effects.Signal;
block Delay "Dead time"
  extends Twinproof.Interfaces.SignalEffect;

  parameter Real T(unit = "s", min = 0, max = 0.5, nominal = 0.01) = 0 "Dead time";
  parameter Real T_min(unit = "s", min = 1e-6, nominal = 1e-3) = 1e-3
    "Shortest dead time represented exactly" annotation(__twinproof(known = true));
  parameter Real T_max(unit = "s", min = 1e-6, nominal = 0.5) = 0.5
    "Longest dead time, for which memory is kept" annotation(__twinproof(known = true));
protected
  final parameter Real T_r(unit = "s") = max(T, T_min) "Dead time of the memory";
equation
  y = u + T / T_r * (delay(u, T_r, T_max) - u);

  annotation(Documentation(info = "<html>
  <p>The signal arrives <code>T</code> later: a bus, a filter in a sensor, the sampling of a
  controller. Before <code>T</code> has passed the output is the first input.</p>
  <p>Below <code>T_min</code> the block is <code>y = u + (T/T_min)*(u(t - T_min) - u)</code>.
  So it is exactly absent at <code>T = 0</code>, nothing is divided by zero, and a small
  <code>T</code> has the right first-order effect <code>-T*der(u)</code>; from
  <code>T_min</code> on it is exact. Set <code>T_min</code> to the sampling interval when that
  is longer.</p>
  <h4>Reference</h4>
  <ul>
  <li>K. J. &Aring;str&ouml;m, R. M. Murray, <em>Feedback Systems</em> (2008)</li>
  </ul>
  </html>"));
end Delay;
