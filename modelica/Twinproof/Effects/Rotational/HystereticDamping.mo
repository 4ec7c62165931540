within Twinproof.Effects.Rotational;
model HystereticDamping "Dry friction that grows with the distance from the rest position"
  extends Twinproof.Interfaces.RotationalEffect;

  parameter Real k_h(unit = "N.m/rad", min = 0, nominal = 0.5) = 0
    "Friction torque per angle from phi = 0";
  parameter Real w_0(unit = "rad/s", min = 1e-4, nominal = 0.05) = 0.05
    "Speed at which the smoothed sign has reached 76 %" annotation(__twinproof(known = true));
equation
  flange.tau = k_h * abs(phi) * tanh(w / w_0);

  annotation(Documentation(info = "<html>
  <p>Torque <code>k_h*|phi|*sign(w)</code>, of joints and clamps that are pressed together the
  more, the more they are bent: the loss of a cycle grows with the square of its size and does not
  depend on its frequency. A positive parameter opposes motion.</p>
  <p>The sign of the speed is written <code>tanh(w/w_0)</code>, which keeps the law differentiable
  and free of events; <code>w_0</code> is a numerical width and is not fitted (see <a
  href=\"modelica://Twinproof.Effects.Rotational.CoulombFriction\">CoulombFriction</a>).</p>
  <h4>Reference</h4>
  <ul>
  <li>T. J. Reid, <em>Free vibration and hysteretic damping</em>, Journal of the Royal
  Aeronautical Society 60 (1956) 283</li>
  </ul>
  </html>"));
end HystereticDamping;
