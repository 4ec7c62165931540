within Twinproof.Effects.Translational;
model ForceRipple "Force that repeats along the way"
  extends Twinproof.Interfaces.TranslationalEffect;

  parameter Real f_s(unit = "N", nominal = 1) = 0 "Sine part of the ripple";
  parameter Real f_k(unit = "N", nominal = 1) = 0 "Cosine part of the ripple";
  parameter Real p(unit = "m", min = 1e-5, nominal = 0.01) = 5e-3 "Length of a period"
    annotation(__twinproof(known = true));
equation
  flange.f = f_s * sin(2 * 3.14159265358979 * s / p) + f_k * cos(2 * 3.14159265358979 * s / p);

  annotation(Documentation(info = "<html>
  <p>The lead of a screw, the teeth of a belt, the poles of a linear motor. <code>p</code> comes
  from the data sheet (5 mm is the most common lead); it is not fitted, since records fit many
  wrong lengths a little. Without a reference run the phase belongs to one recording only. The
  ripple is conservative.</p>
  <h4>Reference</h4>
  <ul>
  <li>J. R. Hendershot, T. J. E. Miller, <em>Design of Brushless Permanent-Magnet Machines</em>
  (2010)</li>
  </ul>
  </html>"));
end ForceRipple;
