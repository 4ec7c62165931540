within Twinproof.Effects.Signal;
block Gain "Scale error: the signal is larger by a factor 1 + k"
  extends Twinproof.Interfaces.SignalEffect;

  parameter Real k(unit = "1", nominal = 0.05) = 0 "Relative error of scale";
equation
  y = (1 + k) * u;

  annotation(Documentation(info = "<html>
  <p>A sensor or an amplifier that is out of calibration. At <code>k = 0</code> the signal is
  untouched.</p>
  <h4>Reference</h4>
  <ul>
  <li>E. O. Doebelin, <em>Measurement Systems: Application and Design</em>, 5th ed.
  (2004)</li>
  </ul>
  </html>"));
end Gain;
