within Twinproof.Effects.Rotational;
model StribeckFriction "Excess of friction near standstill, to be put on top of Coulomb friction"
  extends Twinproof.Interfaces.RotationalEffect;

  parameter Real tau_s(unit = "N.m", min = 0, nominal = 0.05) = 0
    "Breakaway torque minus Coulomb friction torque";
  parameter Real w_s(unit = "rad/s", min = 0.1, max = 2, nominal = 0.5) = 0.5
    "Stribeck speed, at which 37 % of the excess is left";
  parameter Real w_0(unit = "rad/s", min = 1e-4, nominal = 0.05) = 0.05
    "Speed at which the smoothed sign has reached 76 %" annotation(__twinproof(known = true));
equation
  flange.tau = tau_s * exp(-(w / w_s)^2) * tanh(w / w_0);

  annotation(Documentation(info = "<html>
  <p>Torque <code>tau_s*exp(-(w/w_s)^2)*sign(w)</code>: friction that falls as a lubricating
  film builds up. It is the excess alone; <a
  href=\"modelica://Twinproof.Effects.Rotational.CoulombFriction\">CoulombFriction</a> gives
  the level it falls to. A positive parameter opposes motion.</p>
  <p><code>w_s</code> shapes the law and is bounded by physics: below 0.1 rad/s the bump hides
  in the smoothing, above 2 rad/s it is Coulomb friction.</p>
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
  <li>H. Olsson, K. J. &Aring;str&ouml;m, C. Canudas de Wit, M. G&auml;fvert, P. Lischinsky,
  <em>Friction models and friction compensation</em>, European Journal of Control 4 (1998)
  176-195</li>
  </ul>
  </html>"));
end StribeckFriction;
