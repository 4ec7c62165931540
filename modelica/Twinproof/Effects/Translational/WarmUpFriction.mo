within Twinproof.Effects.Translational;
model WarmUpFriction "Viscous friction that fades as the lubricant warms up"
  extends Twinproof.Interfaces.TranslationalEffect;

  parameter Real d_w(unit = "N.s/m", min = 0, nominal = 50) = 0
    "Excess of viscous friction at the start";
  parameter Real T_w(unit = "s", min = 5, max = 2000, nominal = 60) = 30
    "Time after which 37 % of it is left";
equation
  flange.f = d_w * exp(-time / T_w) * v;

  annotation(Documentation(info = "<html>
  <p>Force <code>d_w*exp(-t/T_w)*v</code> with the time since the recording began: one thermal
  mass that warms up under steady use. It is the excess over the warm machine; <a
  href=\"modelica://Twinproof.Effects.Translational.ViscousFriction\">ViscousFriction</a> is what
  is left. A positive parameter opposes motion.</p>
  <p>The temperature is written as a function of time, not as a state: a state that slow would be
  free to differ at every start of a fitted window.</p>
  <h4>Reference</h4>
  <ul>
  <li>A. C. Bittencourt, S. Gunnarsson, <em>Static friction in a robot joint - modeling and
  identification of load and temperature effects</em>, Journal of Dynamic Systems, Measurement,
  and Control 134 (2012) 051013</li>
  </ul>
  </html>"));
end WarmUpFriction;
