within Twinproof.Effects.Signal;
block Drift "Zero that moves with time"
  extends Twinproof.Interfaces.SignalEffect;

  parameter Real b_t(min = -2e-3, max = 2e-3, nominal = 1e-3) = 0
    "Drift per second, in the unit of the signal" annotation(__twinproof(unit = "signal/s"));
equation
  y = u + b_t * time;

  annotation(Documentation(info = "<html>
  <p>Offset that grows with the time since the recording began, of a gyroscope that is integrated
  or of a bridge that warms up. The constant part is <a
  href=\"modelica://Twinproof.Effects.Signal.Offset\">Offset</a>. The range is that of a sensor: a
  larger slope of a position is a force that moves the machine.</p>
  <p>Quantities are in the unit of the signal that the block stands in.</p>
  <h4>Reference</h4>
  <ul>
  <li>E. O. Doebelin, <em>Measurement Systems: Application and Design</em>, 5th ed. (2004)</li>
  </ul>
  </html>"));
end Drift;
