within Twinproof.Effects.Translational;
model ViscousFriction "Friction force proportional to speed"
  extends Twinproof.Interfaces.TranslationalEffect;

  parameter Real d(unit = "N.s/m", min = 0, nominal = 100) = 0 "Viscous friction coefficient";
equation
  flange.f = d * v;

  annotation(Documentation(info = "<html>
  <p>Force <code>d*v</code> of a lubricated bearing or of eddy currents. A positive parameter
  opposes motion.</p>
  <h4>Reference</h4>
  <ul>
  <li>B. Armstrong-H&eacute;louvry, P. Dupont, C. Canudas de Wit, <em>A survey of models,
  analysis tools and compensation methods for the control of machines with friction</em>,
  Automatica 30 (1994) 1083-1138</li>
  </ul>
  </html>"));
end ViscousFriction;
