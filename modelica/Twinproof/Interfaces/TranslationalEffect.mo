within Twinproof.Interfaces;
partial model TranslationalEffect "A force that depends on the motion of one flange"
  TranslationalFlange flange "Connect to the flange of a point";
  Real s(unit = "m") "Position";
  Real v(unit = "m/s") "Velocity";
equation
  s = flange.s;
  v = der(s);

  annotation(Documentation(info = "<html>
  <p>A class that extends this one gives <code>flange.f</code>, the force that the machine
  spends on the effect: <code>+d*v</code> for a friction that opposes motion.</p>
  <h4>Reference</h4>
  <ul>
  <li>Modelica Association, <em>Modelica Standard Library</em>, version 4</li>
  </ul>
  </html>"));
end TranslationalEffect;
