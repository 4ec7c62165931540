within Twinproof.Effects.Signal;
block DeadZone "Small signals pass as zero, larger ones are reduced by the half width"
  extends Twinproof.Interfaces.SignalEffect;

  parameter Real w(min = 0, nominal = 0.05) = 0 "Half width, in the unit of the signal";
equation
  y = smooth(0, if u > w then u - w elseif u < -w then u + w else 0.0);

  annotation(Documentation(info = "<html>
  <p>An amplifier or a geared motor that does nothing below a threshold. The output is
  continuous, so no event is needed. Quantities are in the unit of the signal that the block
  stands in.</p>
  <h4>Reference</h4>
  <ul>
  <li>J.-J. E. Slotine, W. Li, <em>Applied Nonlinear Control</em> (1991)</li>
  <li>G. Tao, P. V. Kokotovi&#263;, <em>Adaptive Control of Systems with Actuator and Sensor
  Nonlinearities</em> (1996)</li>
  </ul>
  </html>"));
end DeadZone;
