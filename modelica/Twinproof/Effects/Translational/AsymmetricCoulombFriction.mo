within Twinproof.Effects.Translational;
model AsymmetricCoulombFriction "Coulomb friction that differs between the two directions of motion"
  extends Twinproof.Interfaces.TranslationalEffect;

  parameter Real f_a(unit = "N", nominal = 10) = 0
    "Half the difference of Coulomb friction between positive and negative motion";
  parameter Real v_0(unit = "m/s", min = 1e-6, nominal = 1e-3) = 1e-3
    "Speed at which the smoothed sign has reached 76 %" annotation(__twinproof(known = true));
equation
  flange.f = f_a * tanh(v / v_0)^2;

  annotation(Documentation(info = "<html>
  <p>The direction-dependent part alone, <code>f_a*sign(v)^2</code>: a positive parameter
  opposes positive motion and helps negative motion. With <a
  href=\"modelica://Twinproof.Effects.Translational.CoulombFriction\">CoulombFriction</a> the
  levels are <code>f_c + f_a</code> forwards and <code>f_c - f_a</code> backwards; the pair
  dissipates while <code>|f_a| &lt;= f_c</code>.</p>
  <p>While the machine moves it equals a <a
  href=\"modelica://Twinproof.Effects.Translational.ConstantForce\">ConstantForce</a> of
  <code>-f_a</code>; only what happens at standstill tells the two apart.</p>
  <p>The squared <code>tanh(v/v_0)</code> is zero at rest and one in motion. <code>v_0</code>
  is a numerical width and is not fitted; its default is 1 % of the 0.1 m/s at which a
  positioner's carriage travels, so the law is a Coulomb law for the data and still smooth for
  a solver with 1 ms steps.</p>
  <h4>Reference</h4>
  <ul>
  <li>B. Armstrong-H&eacute;louvry, P. Dupont, C. Canudas de Wit, <em>A survey of models,
  analysis tools and compensation methods for the control of machines with friction</em>,
  Automatica 30 (1994) 1083-1138</li>
  <li>A. Janot, M. Gautier, M. Brunot, <em>Data set and reference models of EMPS</em>,
  Workshop on Nonlinear System Identification Benchmarks (2019)</li>
  </ul>
  </html>"));
end AsymmetricCoulombFriction;
