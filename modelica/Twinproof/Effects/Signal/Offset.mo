within Twinproof.Effects.Signal;
block Offset "Constant added to the signal"
  extends Twinproof.Interfaces.SignalEffect;

  parameter Real b(nominal = 0.05) = 0 "Offset, in the unit of the signal";
equation
  y = u + b;

  annotation(Documentation(info = "<html>
  <p>Zero error of a sensor, or bias of an amplifier. Quantities are in the unit of the signal
  that the block stands in.</p>
  <h4>Reference</h4>
  <ul>
  <li>E. O. Doebelin, <em>Measurement Systems: Application and Design</em>, 5th ed.
  (2004)</li>
  </ul>
  </html>"));
end Offset;
