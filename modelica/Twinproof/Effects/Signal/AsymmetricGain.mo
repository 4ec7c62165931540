within Twinproof.Effects.Signal;
block AsymmetricGain "Scale that differs between positive and negative signals"
  extends Twinproof.Interfaces.SignalEffect;

  parameter Real k(unit = "1", min = -1, max = 1, nominal = 0.05) = 0
    "Relative gain added to positive signals and taken from negative ones";
equation
  y = u + k * abs(u);

  annotation(Documentation(info = "<html>
  <p>Gain <code>1 + k</code> for positive and <code>1 - k</code> for negative signals, as of
  an H-bridge whose halves differ. Beyond <code>|k| = 1</code> one direction would be
  reversed. The symmetric part is <a
  href=\"modelica://Twinproof.Effects.Signal.Gain\">Gain</a>.</p>
  <h4>Reference</h4>
  <ul>
  <li>E. O. Doebelin, <em>Measurement Systems: Application and Design</em>, 5th ed.
  (2004)</li>
  <li>G. Tao, P. V. Kokotovi&#263;, <em>Adaptive Control of Systems with Actuator and Sensor
  Nonlinearities</em> (1996)</li>
  </ul>
  </html>"));
end AsymmetricGain;
