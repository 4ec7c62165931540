within Twinproof.Effects.Signal;
block EmpiricalOverSignal "Signal bent along a curve, drawn from data: empirical"
  extends Twinproof.Interfaces.SignalEmpirical;

  parameter Real lowest(nominal = 1) = -1 "Where the curve begins, in the unit of the signal"
    annotation(__twinproof(known = true));
  parameter Real highest(nominal = 1) = 1 "Where the curve ends, in the unit of the signal"
    annotation(__twinproof(known = true));
equation
  r = 16 * (u - lowest) / (highest - lowest);

  annotation(__twinproof(search = false), Documentation(info = "<html>
  <p>A smooth curve over the signal, for what no effect of the
  library explains: a limit with rounded corners, an amplifier of another law. It is proposed where
  the data show one, marked as empirical, and never takes part in the search for effects that
  have a name. At an input it stands before named effects of the same place, which may leave
  nothing to be seen of what they cut off.</p>
  <p>Quantities are in the unit of the signal that the block stands in.</p>
  <h4>Reference</h4>
  <ul>
  <li>C. de Boor, <em>A Practical Guide to Splines</em> (2001)</li>
  </ul>
  </html>"));
end EmpiricalOverSignal;
