within Twinproof.Effects.Translational;
model EndStop "Elastic stops on both sides of a free range"
  extends Twinproof.Interfaces.TranslationalEffect;

  parameter Real k_e(unit = "N/m", min = 0, nominal = 1e4) = 0 "Stiffness of the stops";
  parameter Real s_e(unit = "m", min = 5e-3, max = 10, nominal = 0.1) = 0.1
    "Distance at which a stop is touched, on either side of s = 0";
equation
  flange.f = k_e * (s - max(-s_e, min(s_e, s)));

  annotation(Documentation(info = "<html>
  <p>No force inside the range, a stiffness <code>k_e</code> outside of it: a bumper, a tether, a
  hose at the end of its slack. A recording that never touches a stop says nothing about it.</p>
  <h4>Reference</h4>
  <ul>
  <li>S. W. Shaw, P. J. Holmes, <em>A periodically forced piecewise linear oscillator</em>,
  Journal of Sound and Vibration 90 (1983) 129-155</li>
  </ul>
  </html>"));
end EndStop;
