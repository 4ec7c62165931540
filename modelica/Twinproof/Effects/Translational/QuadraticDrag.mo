within Twinproof.Effects.Translational;
model QuadraticDrag "Drag force that grows with the square of speed"
  extends Twinproof.Interfaces.TranslationalEffect;

  parameter Real c(unit = "N.s2/m2", min = 0, nominal = 100) = 0 "Drag coefficient";
equation
  flange.f = c * v * abs(v);

  annotation(Documentation(info = "<html>
  <p>Force <code>c*v*|v|</code> of a body in a turbulent fluid, or of a fan. A positive
  parameter opposes motion.</p>
  <h4>Reference</h4>
  <ul>
  <li>F. M. White, <em>Fluid Mechanics</em>, 7th ed. (2011)</li>
  <li>S. F. Hoerner, <em>Fluid-Dynamic Drag</em> (1965)</li>
  </ul>
  </html>"));
end QuadraticDrag;
