within Twinproof.Sensors;
block Accelerometer "Two accelerometers on a body that leans and turns about an axis"
  parameter Real r(unit = "m", min = 0, nominal = 0.1) = 0
    "Distance from the axis, along the body" annotation(__twinproof(known = true));
  parameter Real b_x(unit = "m/s2", nominal = 0.1) = 0 "Bias across the body";
  parameter Real b_z(unit = "m/s2", nominal = 0.1) = 0 "Bias along the body";
  parameter Real g(unit = "m/s2", min = 9.7, nominal = 9.81) = 9.81 "Acceleration of gravity"
    annotation(__twinproof(known = true));
  parameter Real sd(unit = "m/s2", min = 0, nominal = 0.01) = 0
    "Standard deviation of their noise, for whoever draws it"
    annotation(__twinproof(known = true));
  Interfaces.RealInput theta(unit = "rad") "Lean, zero upright";
  Interfaces.RealInput omega(unit = "rad/s") "Its rate";
  Interfaces.RealInput alpha(unit = "rad/s2") "Its acceleration";
  Interfaces.RealInput a(unit = "m/s2") "Horizontal acceleration of the axis";
  Interfaces.RealOutput a_x(unit = "m/s2") "Reading across the body without its noise";
  Interfaces.RealOutput a_z(unit = "m/s2") "Reading along the body without its noise";
equation
  a_x = a * cos(theta) + r * alpha - g * sin(theta) + b_x;
  a_z = a * sin(theta) - r * omega^2 + g * cos(theta) + b_z;

  annotation(Documentation(info = "<html>
  <p>Specific force, as such a sensor measures it: at rest upright it reads <code>g</code> along the
  body. Across the body a lean forwards counts as negative, like a push backwards.</p>
  <h4>Reference</h4>
  <ul>
  <li>D. H. Titterton, J. L. Weston, <em>Strapdown Inertial Navigation Technology</em>, 2nd ed.
  (2004)</li>
  </ul>
  </html>"));
end Accelerometer;
