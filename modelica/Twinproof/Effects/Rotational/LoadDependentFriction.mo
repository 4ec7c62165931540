within Twinproof.Effects.Rotational;
model LoadDependentFriction "Dry friction of a transmission that carries the weight of a link"
  extends Twinproof.Interfaces.RotationalEffect;

  parameter Real tau_l(unit = "N.m", min = 0, nominal = 0.1) = 0
    "Friction torque while the link is horizontal";
  parameter Real w_0(unit = "rad/s", min = 1e-4, nominal = 0.05) = 0.05
    "Speed at which the smoothed sign has reached 76 %" annotation(__twinproof(known = true));
equation
  flange.tau = tau_l * abs(sin(phi)) * tanh(w / w_0);

  annotation(Documentation(info = "<html>
  <p>Torque <code>tau_l*|sin(phi)|*sign(w)</code>: friction in proportion to the torque that
  gravity puts on the teeth, with <code>phi = 0</code> hanging or upright. The part that does not
  depend on load is <a
  href=\"modelica://Twinproof.Effects.Rotational.CoulombFriction\">CoulombFriction</a>. A positive
  parameter opposes motion.</p>
  <p>The sign of the speed is written <code>tanh(w/w_0)</code>, which keeps the law differentiable
  and free of events; <code>w_0</code> is a numerical width and is not fitted (see <a
  href=\"modelica://Twinproof.Effects.Rotational.CoulombFriction\">CoulombFriction</a>).</p>
  <h4>Reference</h4>
  <ul>
  <li>P. Hamon, M. Gautier, P. Garrec, <em>Dynamic identification of robots with a dry friction
  model depending on load and velocity</em>, IEEE/RSJ International Conference on Intelligent
  Robots and Systems (2010) 6187-6193</li>
  </ul>
  </html>"));
end LoadDependentFriction;
