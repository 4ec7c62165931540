within Twinproof.Sensors;
block Gyroscope "Rate gyroscope: bias, drift, scale and range"
  parameter Real b(unit = "rad/s", nominal = 0.01) = 0 "Bias at the start";
  parameter Real b_t(unit = "rad/s2", nominal = 1e-4) = 0 "Drift of the bias";
  parameter Real k(unit = "1", nominal = 0.01) = 0 "Relative error of scale";
  parameter Real range(unit = "rad/s", min = 0.1, nominal = 5) = 8.7266 "Largest rate"
    annotation(__twinproof(known = true));
  parameter Real sd(unit = "rad/s", min = 0, nominal = 1e-3) = 0
    "Standard deviation of its noise, for whoever draws it" annotation(__twinproof(known = true));
  Interfaces.RealInput omega(unit = "rad/s") "Rate";
  Interfaces.RealOutput rate(unit = "rad/s") "Reading without its noise";
equation
  rate = max(-range, min(range, (1 + k) * omega + b + b_t * time));

  annotation(Documentation(info = "<html>
  <p>The deterministic part of a gyroscope's error model. The default range is 500 degrees per
  second.</p>
  <h4>Reference</h4>
  <ul>
  <li>IEEE Std 952, <em>Specification Format Guide and Test Procedure for Single-Axis
  Interferometric Fiber Optic Gyros</em> (1997)</li>
  </ul>
  </html>"));
end Gyroscope;
