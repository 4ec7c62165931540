within Twinproof.Effects.Rotational;
model AsymmetricCoulombFriction "Coulomb friction that differs between the two directions of motion"
  extends Twinproof.Interfaces.RotationalEffect;

  parameter Real tau_a(unit = "N.m", nominal = 0.1) = 0
    "Half the difference of Coulomb friction between positive and negative motion";
  parameter Real w_0(unit = "rad/s", min = 1e-4, nominal = 0.05) = 0.05
    "Speed at which the smoothed sign has reached 76 %" annotation(__twinproof(known = true));
equation
  flange.tau = tau_a * tanh(w / w_0)^2;

  annotation(Documentation(info = "<html>
  <p>The direction-dependent part alone, <code>tau_a*sign(w)^2</code>: a positive parameter
  opposes positive motion and helps negative motion. With <a
  href=\"modelica://Twinproof.Effects.Rotational.CoulombFriction\">CoulombFriction</a> the
  levels are <code>tau_c + tau_a</code> forwards and <code>tau_c - tau_a</code> backwards; the
  pair dissipates while <code>|tau_a| &lt;= tau_c</code>.</p>
  <p>While the machine moves it equals a <a
  href=\"modelica://Twinproof.Effects.Rotational.ConstantTorque\">ConstantTorque</a> of
  <code>-tau_a</code>; only what happens at standstill tells the two apart.</p>
  <p>The squared <code>tanh(w/w_0)</code> is zero at rest and one in motion. <code>w_0</code>
  is a numerical width and is not fitted; its default is 5 % of the 1 rad/s at which a
  balancing robot's wheel turns, so the law is a Coulomb law for the data and still smooth for
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
