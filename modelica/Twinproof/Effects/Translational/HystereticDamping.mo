within Twinproof.Effects.Translational;
model HystereticDamping "Dry friction that grows with the distance from the rest position"
  extends Twinproof.Interfaces.TranslationalEffect;

  parameter Real k_h(unit = "N/m", min = 0, nominal = 50) = 0
    "Friction force per distance from s = 0";
  parameter Real v_0(unit = "m/s", min = 1e-6, nominal = 1e-3) = 1e-3
    "Speed at which the smoothed sign has reached 76 %" annotation(__twinproof(known = true));
equation
  flange.f = k_h * abs(s) * tanh(v / v_0);

  annotation(Documentation(info = "<html>
  <p>Force <code>k_h*|s|*sign(v)</code>, of joints and clamps that are pressed together the more,
  the more they are bent: the loss of a cycle grows with the square of its size and does not
  depend on its frequency. A positive parameter opposes motion.</p>
  <p>The sign of the speed is written <code>tanh(v/v_0)</code>, which keeps the law differentiable
  and free of events; <code>v_0</code> is a numerical width and is not fitted (see <a
  href=\"modelica://Twinproof.Effects.Translational.CoulombFriction\">CoulombFriction</a>).</p>
  <h4>Reference</h4>
  <ul>
  <li>T. J. Reid, <em>Free vibration and hysteretic damping</em>, Journal of the Royal
  Aeronautical Society 60 (1956) 283</li>
  </ul>
  </html>"));
end HystereticDamping;
