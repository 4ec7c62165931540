within Twinproof.Effects.Rotational;
model QuadraticDrag "Drag torque that grows with the square of speed"
  extends Twinproof.Interfaces.RotationalEffect;

  parameter Real c(unit = "N.m.s2/rad2", min = 0, nominal = 0.01) = 0 "Drag coefficient";
equation
  flange.tau = c * w * abs(w);

  annotation(Documentation(info = "<html>
  <p>Torque <code>c*w*|w|</code> of a body in a turbulent fluid, or of a fan. A positive
  parameter opposes motion.</p>
  <h4>Reference</h4>
  <ul>
  <li>F. M. White, <em>Fluid Mechanics</em>, 7th ed. (2011)</li>
  <li>S. F. Hoerner, <em>Fluid-Dynamic Drag</em> (1965)</li>
  </ul>
  </html>"));
end QuadraticDrag;
