within Twinproof.Effects.Translational;
model CubicSpring "Restoring force that grows with the cube of position"
  extends Twinproof.Interfaces.TranslationalEffect;

  parameter Real k3(unit = "N/m3", nominal = 1e5) = 0 "Cubic stiffness, zero force at s = 0";
equation
  flange.f = k3 * s^3;

  annotation(Documentation(info = "<html>
  <p>Force <code>k3*s^3</code> towards <code>s = 0</code>: the hardening (positive) or
  softening (negative) part of a spring.</p>
  <h4>Reference</h4>
  <ul>
  <li>A. H. Nayfeh, D. T. Mook, <em>Nonlinear Oscillations</em> (1979) (the Duffing
  oscillator)</li>
  </ul>
  </html>"));
end CubicSpring;
