within Twinproof.Effects.Signal;
block AffineAmplifier "Amplifier that jumps by a constant where its input changes sign"
  extends Twinproof.Interfaces.SignalEffect;

  parameter Real b(min = 0, nominal = 0.05) = 0
    "Height of the jump to either side, in the unit of the signal";
  parameter Real u_0(min = 1e-6, nominal = 0.01) = 0.01
    "Signal at which the smoothed sign has reached 76 %, in the unit of the signal"
    annotation(__twinproof(known = true));
equation
  y = u + b * tanh(u / u_0);

  annotation(Documentation(info = "<html>
  <p>Output <code>u + b*sign(u)</code>: a drive that compensates a dead zone or a friction by
  itself, more than there is. The opposite, an output reduced by a constant, is <a
  href=\"modelica://Twinproof.Effects.Signal.DeadZone\">DeadZone</a>. <code>u_0</code> is a
  numerical width and is not fitted.</p>
  <p>Quantities are in the unit of the signal that the block stands in.</p>
  <h4>Reference</h4>
  <ul>
  <li>G. Tao, P. V. Kokotovi&#263;, <em>Adaptive Control of Systems with Actuator and Sensor
  Nonlinearities</em> (1996)</li>
  </ul>
  </html>"));
end AffineAmplifier;
