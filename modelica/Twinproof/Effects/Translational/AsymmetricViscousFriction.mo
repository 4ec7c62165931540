within Twinproof.Effects.Translational;
model AsymmetricViscousFriction "Viscous friction that differs between the two directions of motion"
  extends Twinproof.Interfaces.TranslationalEffect;

  parameter Real d_a(unit = "N.s/m", nominal = 100) = 0
    "Half the difference of viscous friction between positive and negative motion";
equation
  flange.f = d_a * abs(v);

  annotation(Documentation(info = "<html>
  <p>The direction-dependent part alone, <code>d_a*|v|</code>: a positive parameter opposes
  positive motion and helps negative motion. With <a
  href=\"modelica://Twinproof.Effects.Translational.ViscousFriction\">ViscousFriction</a> the
  coefficients are <code>d + d_a</code> forwards and <code>d - d_a</code> backwards; the pair
  dissipates while <code>|d_a| &lt;= d</code>. Written so, the two are not collinear.</p>
  <h4>Reference</h4>
  <ul>
  <li>B. Armstrong-H&eacute;louvry, P. Dupont, C. Canudas de Wit, <em>A survey of models,
  analysis tools and compensation methods for the control of machines with friction</em>,
  Automatica 30 (1994) 1083-1138</li>
  <li>A. Janot, M. Gautier, M. Brunot, <em>Data set and reference models of EMPS</em>,
  Workshop on Nonlinear System Identification Benchmarks (2019)</li>
  </ul>
  </html>"));
end AsymmetricViscousFriction;
