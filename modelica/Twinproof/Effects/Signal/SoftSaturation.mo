within Twinproof.Effects.Signal;
block SoftSaturation "Limit on the size of the signal, reached gradually"
  extends Twinproof.Interfaces.SignalEffect;

  parameter Real s(min = 0, nominal = 0.01) = 0
    "One over the square of the largest size, in the inverse squared unit of the signal";
equation
  y = u / sqrt(1 + s * u^2);

  annotation(Documentation(info = "<html>
  <p>Grows ever more slowly towards <code>1/sqrt(s)</code>: a power stage, a magnet, a valve.
  Unlike the sharp <a href=\"modelica://Twinproof.Effects.Signal.Saturation\">Saturation</a> it
  leaves a trace in signals well below the limit, <code>-s*u^3/2</code>.</p>
  <p>Quantities are in the unit of the signal that the block stands in.</p>
  <h4>Reference</h4>
  <ul>
  <li>G. Tao, P. V. Kokotovi&#263;, <em>Adaptive Control of Systems with Actuator and Sensor
  Nonlinearities</em> (1996)</li>
  </ul>
  </html>"));
end SoftSaturation;
