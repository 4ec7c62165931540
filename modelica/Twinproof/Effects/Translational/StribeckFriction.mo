within Twinproof.Effects.Translational;
model StribeckFriction "Excess of friction near standstill, to be put on top of Coulomb friction"
  extends Twinproof.Interfaces.TranslationalEffect;

  parameter Real f_s(unit = "N", min = 0, nominal = 5) = 0
    "Breakaway force minus Coulomb friction force";
  parameter Real v_s(unit = "m/s", min = 2e-3, max = 0.1, nominal = 0.01) = 0.01
    "Stribeck speed, at which 37 % of the excess is left";
  parameter Real v_0(unit = "m/s", min = 1e-6, nominal = 1e-3) = 1e-3
    "Speed at which the smoothed sign has reached 76 %" annotation(__twinproof(known = true));
equation
  flange.f = f_s * exp(-(v / v_s)^2) * tanh(v / v_0);

  annotation(Documentation(info = "<html>
  <p>Force <code>f_s*exp(-(v/v_s)^2)*sign(v)</code>: friction that falls as a lubricating film
  builds up. It is the excess alone; <a
  href=\"modelica://Twinproof.Effects.Translational.CoulombFriction\">CoulombFriction</a>
  gives the level it falls to. A positive parameter opposes motion.</p>
  <p><code>v_s</code> shapes the law and is bounded by physics: below 2 mm/s the bump hides in
  the smoothing, above 0.1 m/s it is Coulomb friction.</p>
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
  <li>H. Olsson, K. J. &Aring;str&ouml;m, C. Canudas de Wit, M. G&auml;fvert, P. Lischinsky,
  <em>Friction models and friction compensation</em>, European Journal of Control 4 (1998)
  176-195</li>
  </ul>
  </html>"));
end StribeckFriction;
