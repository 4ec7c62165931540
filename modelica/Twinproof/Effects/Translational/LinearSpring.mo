within Twinproof.Effects.Translational;
model LinearSpring "Restoring force proportional to position"
  extends Twinproof.Interfaces.TranslationalEffect;

  parameter Real k(unit = "N/m", nominal = 1000) = 0 "Stiffness, zero force at s = 0";
equation
  flange.f = k * s;

  annotation(Documentation(info = "<html>
  <p>Force <code>k*s</code> towards <code>s = 0</code>, of a cable, a belt or a flexure. A
  positive parameter pulls back; a negative one is possible (an unbalanced mass, a
  magnet).</p>
  <h4>Reference</h4>
  <ul>
  <li>L. Meirovitch, <em>Fundamentals of Vibrations</em> (2001)</li>
  </ul>
  </html>"));
end LinearSpring;
