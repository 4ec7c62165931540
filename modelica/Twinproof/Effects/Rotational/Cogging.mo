within Twinproof.Effects.Rotational;
model Cogging "Torque that repeats with the poles or teeth of one turn"
  extends Twinproof.Interfaces.RotationalEffect;

  parameter Real tau_s(unit = "N.m", nominal = 0.02) = 0 "Sine part of the ripple";
  parameter Real tau_k(unit = "N.m", nominal = 0.02) = 0 "Cosine part of the ripple";
  parameter Real n(unit = "1", min = 1, max = 1000, nominal = 10) = 12 "Periods per turn"
    annotation(__twinproof(known = true));
equation
  flange.tau = tau_s * sin(n * phi) + tau_k * cos(n * phi);

  annotation(Documentation(info = "<html>
  <p>Permanent magnets that prefer some angles, or teeth that mesh unevenly. <code>n</code> counts
  slots or teeth and comes from the data sheet; it is not fitted, since records fit many wrong
  counts a little. The ripple is conservative.</p>
  <h4>Reference</h4>
  <ul>
  <li>J. R. Hendershot, T. J. E. Miller, <em>Design of Brushless Permanent-Magnet Machines</em>
  (2010)</li>
  </ul>
  </html>"));
end Cogging;
