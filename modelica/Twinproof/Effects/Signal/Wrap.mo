within Twinproof.Effects.Signal;
block Wrap "Angle that starts again after half a turn"
  extends Twinproof.Interfaces.SignalEffect(u(unit = "rad"), y(unit = "rad"));

  parameter Real k(unit = "1", min = 0, max = 1, nominal = 1) = 0 "1 where it wraps, 0 where not";
equation
  y = u + (if k > 0.001 then 1.0 else k) * (atan2(sin(u), cos(u)) - u);

  annotation(Documentation(info = "<html>
  <p>An absolute encoder or a compass, whose reading stays between <code>-pi</code> and
  <code>pi</code>. It wraps or it does not, so every <code>k</code> above 0.001 means that it does;
  the little below serves to find it from 0.</p>
  <h4>Reference</h4>
  <ul>
  <li>E. O. Doebelin, <em>Measurement Systems: Application and Design</em>, 5th ed. (2004)</li>
  </ul>
  </html>"));
end Wrap;
