within Twinproof.Effects.Signal;
block Quantisation "Rounding to steps"
  extends Twinproof.Interfaces.SignalEffect;

  parameter Real q(min = 0, nominal = 0.01) = 0 "Step, in the unit of the signal";
  parameter Real q_min(min = 1e-12, nominal = 1e-6) = 1e-6
    "Smallest step represented exactly, in the unit of the signal"
    annotation(__twinproof(known = true));
protected
  final parameter Real q_r = max(q, q_min) "Step of the rounding, in the unit of the signal";
equation
  y = u + q / q_r * (q_r * noEvent(floor(u / q_r + 0.5)) - u);

  annotation(Documentation(info = "<html>
  <p>A converter or an encoder with coarse steps. It is for simulation: a fit feels no slope in a
  staircase. Steps make no events. That a recording is quantised is better told as
  <code>resolution</code> in its channel map.</p>
  <p>Quantities are in the unit of the signal that the block stands in.</p>
  <h4>Reference</h4>
  <ul>
  <li>B. Widrow, I. Koll&aacute;r, <em>Quantization Noise</em> (2008)</li>
  </ul>
  </html>"));
end Quantisation;
