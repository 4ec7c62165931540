within Twinproof.Effects.Signal;
block RateLimit "Limit on how fast the signal may change"
  extends Twinproof.Interfaces.SignalEffect;

  parameter Real inverse_rate(min = 0, nominal = 0.1) = 0
    "One over the largest rate, in seconds per unit of the signal; 0 for no limit"
    annotation(__twinproof(unit = "s/signal"));
  parameter Real T(unit = "s", min = 1e-4, nominal = 0.01) = 0.01
    "Time constant of the follower" annotation(__twinproof(known = true));
  parameter Real x_start = 0 "Start of the follower, in the unit of the signal";
  Real x(start = x_start, fixed = true) "Follower, in the unit of the signal";
  Real e "What the limit holds back, in the unit of the signal";
equation
  e = inverse_rate * (u - x) * abs(u - x) / (T + inverse_rate * abs(u - x));
  T * der(x) = u - x - e;
  y = u - e;

  annotation(__twinproof(search = false), Documentation(info = "<html>
  <p>A servo valve, a drive with a ramp. The output follows at no more than
  <code>1/inverse_rate</code>; what the follower lags behind by <code>T</code> is added again, so
  that the block is exactly absent at 0; steps smaller than <code>T/inverse_rate</code> pass
  almost at once. The inverse is the parameter so that 0 means that the effect is absent.</p>
  <p>A limit larger than every rate leaves almost no trace in the data: start a fit from one over
  the largest rate, not from 0.</p>
  <h4>Reference</h4>
  <ul>
  <li>J.-J. E. Slotine, W. Li, <em>Applied Nonlinear Control</em> (1991)</li>
  <li>G. Tao, P. V. Kokotovi&#263;, <em>Adaptive Control of Systems with Actuator and Sensor
  Nonlinearities</em> (1996)</li>
  </ul>
  </html>"));
end RateLimit;
