within Twinproof.Effects.Signal;
block GainDrift "Scale that moves with time"
  extends Twinproof.Interfaces.SignalEffect;

  parameter Real k_t(unit = "1/s", nominal = 1e-3) = 0 "Relative change of scale per second";
equation
  y = (1 + k_t * time) * u;

  annotation(Documentation(info = "<html>
  <p>A motor whose copper warms up, a battery that empties, a sensor that ages: gain that changes
  in proportion to the time since the recording began. A constant error of scale is <a
  href=\"modelica://Twinproof.Effects.Signal.Gain\">Gain</a>.</p>
  <h4>Reference</h4>
  <ul>
  <li>E. O. Doebelin, <em>Measurement Systems: Application and Design</em>, 5th ed. (2004)</li>
  </ul>
  </html>"));
end GainDrift;
