within Twinproof.Effects.Translational;
model CoulombFriction "Dry friction: force of constant size against the direction of motion"
  extends Twinproof.Interfaces.TranslationalEffect;

  parameter Real f_c(unit = "N", min = 0, nominal = 10) = 0 "Coulomb friction force";
  parameter Real v_0(unit = "m/s", min = 1e-6, nominal = 1e-3) = 1e-3
    "Speed at which the smoothed sign has reached 76 %" annotation(__twinproof(known = true));
equation
  flange.f = f_c * tanh(v / v_0);

  annotation(Documentation(info = "<html>
  <p>Force <code>f_c*sign(v)</code>. A positive parameter opposes motion.</p>
  <p>The sign of the speed is written <code>tanh(v/v_0)</code>, which keeps the law
  differentiable and free of events. <code>v_0</code> is a numerical width, not a property of
  the machine, and is not fitted; its default is 1 % of the 0.1 m/s at which a positioner's
  carriage travels, so the law is a Coulomb law for the data and still smooth for a solver
  with 1 ms steps. Standstill is therefore a creep far slower than <code>v_0</code>, not a
  true stick.</p>
  <h4>Reference</h4>
  <ul>
  <li>B. Armstrong-H&eacute;louvry, P. Dupont, C. Canudas de Wit, <em>A survey of models,
  analysis tools and compensation methods for the control of machines with friction</em>,
  Automatica 30 (1994) 1083-1138</li>
  <li>A. Janot, M. Gautier, M. Brunot, <em>Data set and reference models of EMPS</em>,
  Workshop on Nonlinear System Identification Benchmarks (2019)</li>
  </ul>
  </html>"));
end CoulombFriction;
