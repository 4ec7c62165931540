within Twinproof.Effects.Signal;
block Saturation "Limit on the size of the signal"
  extends Twinproof.Interfaces.SignalEffect;

  parameter Real inverse_limit(min = 0, nominal = 0.1) = 0
    "One over the largest size, in the inverse unit of the signal; 0 for no limit"
    annotation(__twinproof(unit = "1/signal"));
equation
  y = u / max(1.0, inverse_limit * abs(u));

  annotation(Documentation(info = "<html>
  <p>The signal is cut at <code>1/inverse_limit</code> on both sides. The inverse is the
  parameter so that 0 means that the effect is absent. A limit larger than every signal leaves
  no trace in the data: start a fit from one over the largest signal, not from 0.</p>
  <p>Quantities are in the unit of the signal that the block stands in.</p>
  <h4>Reference</h4>
  <ul>
  <li>J.-J. E. Slotine, W. Li, <em>Applied Nonlinear Control</em> (1991)</li>
  <li>G. Tao, P. V. Kokotovi&#263;, <em>Adaptive Control of Systems with Actuator and Sensor
  Nonlinearities</em> (1996)</li>
  </ul>
  </html>"));
end Saturation;
