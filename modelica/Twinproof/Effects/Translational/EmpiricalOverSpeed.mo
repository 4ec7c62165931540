within Twinproof.Effects.Translational;
model EmpiricalOverSpeed "Force as a curve over velocity, drawn from data: empirical"
  extends Twinproof.Interfaces.TranslationalEmpirical;

  parameter Real lowest(unit = "m/s", nominal = 1) = -1 "Where the curve begins"
    annotation(__twinproof(known = true));
  parameter Real highest(unit = "m/s", nominal = 1) = 1 "Where the curve ends"
    annotation(__twinproof(known = true));
equation
  r = 8 * (v - lowest) / (highest - lowest);

  annotation(__twinproof(search = false), Documentation(info = "<html>
  <p>A smooth curve over velocity, for a force that no effect of the
  library explains. It is proposed where the data show one, marked as empirical, and never
  takes part in the search for effects that have a name.</p>
  <h4>Reference</h4>
  <ul>
  <li>C. de Boor, <em>A Practical Guide to Splines</em> (2001)</li>
  </ul>
  </html>"));
end EmpiricalOverSpeed;
