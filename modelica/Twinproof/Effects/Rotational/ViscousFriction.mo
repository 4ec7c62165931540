within Twinproof.Effects.Rotational;
model ViscousFriction "Friction torque proportional to speed"
  extends Twinproof.Interfaces.RotationalEffect;

  parameter Real d(unit = "N.m.s/rad", min = 0, nominal = 0.1) = 0 "Viscous friction coefficient";
equation
  flange.tau = d * w;

  annotation(Documentation(info = "<html>
  <p>Torque <code>d*w</code> of a lubricated bearing or of eddy currents. A positive parameter
  opposes motion.</p>
  <h4>Reference</h4>
  <ul>
  <li>B. Armstrong-H&eacute;louvry, P. Dupont, C. Canudas de Wit, <em>A survey of models,
  analysis tools and compensation methods for the control of machines with friction</em>,
  Automatica 30 (1994) 1083-1138</li>
  </ul>
  </html>"));
end ViscousFriction;
