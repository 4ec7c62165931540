within Twinproof.Effects.Rotational;
model CoulombFriction "Dry friction: torque of constant size against the direction of motion"
  extends Twinproof.Interfaces.RotationalEffect;

  parameter Real tau_c(unit = "N.m", min = 0, nominal = 0.1) = 0 "Coulomb friction torque";
  parameter Real w_0(unit = "rad/s", min = 1e-4, nominal = 0.05) = 0.05
    "Speed at which the smoothed sign has reached 76 %" annotation(__twinproof(known = true));
equation
  flange.tau = tau_c * tanh(w / w_0);

  annotation(Documentation(info = "<html>
  <p>Torque <code>tau_c*sign(w)</code>. A positive parameter opposes motion.</p>
  <p>The sign of the speed is written <code>tanh(w/w_0)</code>, which keeps the law
  differentiable and free of events. <code>w_0</code> is a numerical width, not a property of
  the machine, and is not fitted; its default is 5 % of the 1 rad/s at which a balancing
  robot's wheel turns, so the law is a Coulomb law for the data and still smooth for a solver
  with 1 ms steps. Standstill is therefore a creep far slower than <code>w_0</code>, not a
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
