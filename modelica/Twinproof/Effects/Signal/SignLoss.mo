within Twinproof.Effects.Signal;
block SignLoss "Only the size of the signal is passed on"
  extends Twinproof.Interfaces.SignalEffect;

  parameter Real k(unit = "1", min = 0, max = 1, nominal = 1) = 0
    "1 where the sign is lost, 0 where not";
equation
  y = u + (if k > 0.001 then 1.0 else k) * (abs(u) - u);

  annotation(Documentation(info = "<html>
  <p>A speed from the frequency of pulses, a rectified measurement: <code>|u|</code>. A sign is
  lost or it is not, so every <code>k</code> above 0.001 means that it is; the little below serves
  to find it from 0. A gain that only differs between the signs is <a
  href=\"modelica://Twinproof.Effects.Signal.AsymmetricGain\">AsymmetricGain</a>.</p>
  <h4>Reference</h4>
  <ul>
  <li>E. O. Doebelin, <em>Measurement Systems: Application and Design</em>, 5th ed. (2004)</li>
  </ul>
  </html>"));
end SignLoss;
