within Twinproof.Effects.Rotational;
model EmpiricalOverAngle "Torque as a curve over angle, drawn from data: empirical"
  extends Twinproof.Interfaces.RotationalEmpirical;

  parameter Real lowest(unit = "rad", nominal = 1) = -1 "Where the curve begins"
    annotation(__twinproof(known = true));
  parameter Real highest(unit = "rad", nominal = 1) = 1 "Where the curve ends"
    annotation(__twinproof(known = true));
equation
  r = 8 * (phi - lowest) / (highest - lowest);

  annotation(__twinproof(search = false), Documentation(info = "<html>
  <p>A smooth curve over angle, for a torque that no effect of the
  library explains. It is proposed where the data show one, marked as empirical, and never
  takes part in the search for effects that have a name.</p>
  <h4>Reference</h4>
  <ul>
  <li>C. de Boor, <em>A Practical Guide to Splines</em> (2001)</li>
  </ul>
  </html>"));
end EmpiricalOverAngle;
