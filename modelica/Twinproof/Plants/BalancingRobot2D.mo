within Twinproof.Plants;
model BalancingRobot2D "Self-balancing robot that moves along a line"
  parameter Real M_w(unit = "kg", min = 1e-3, nominal = 0.1) = 0.071 "Mass of both wheels"
    annotation(__twinproof(known = true));
  parameter Real M_b(unit = "kg", min = 1e-3, nominal = 1) = 0.5392 "Mass of the body"
    annotation(__twinproof(known = true));
  parameter Real J_b(unit = "kg.m2", min = 0, nominal = 1e-3) = 2.16e-3
    "Inertia of the body about its centre of mass";
  parameter Real J_w(unit = "kg.m2", min = 0, nominal = 1e-5) = 8.63e-6 "Inertia of both wheels";
  parameter Real J_m(unit = "kg.m2", min = 0, nominal = 1e-7) = 1.3e-7 "Inertia of both rotors";
  parameter Real l(unit = "m", min = 1e-3, nominal = 0.1) = 0.1073
    "Distance of the body's centre of mass from the axle";
  parameter Real r(unit = "m", min = 1e-3, nominal = 0.03) = 0.0249 "Radius of the wheels"
    annotation(__twinproof(known = true));
  parameter Real c(unit = "N.m.s/rad", min = 0, nominal = 1e-4) = 1e-4
    "Viscous friction coefficient between body and wheels";
  parameter Real g_r(unit = "1", min = 1, nominal = 30) = 30 "Gear ratio"
    annotation(__twinproof(known = true));
  parameter Real a(unit = "N.m/A", min = 1e-6, nominal = 0.1) = 6.28e-2
    "Torque on the wheels per ampere" annotation(__twinproof(known = true));
  parameter Real g(unit = "m/s2", min = 9.7, nominal = 9.81) = 9.81 "Acceleration of gravity"
    annotation(__twinproof(known = true));
  parameter Real theta_b_start(unit = "rad") = 0 "Tilt of the body at the start";
  parameter Real theta_m_start(unit = "rad") = 0 "Angle of the wheels to the body at the start";
  parameter Real omega_b_start(unit = "rad/s") = 0 "Tilt rate at the start";
  parameter Real omega_m_start(unit = "rad/s") = 0 "Speed of the wheels to the body at the start";
  Interfaces.RealInput u(unit = "A") "Motor current";
  Interfaces.RealOutput theta_b(unit = "rad", start = theta_b_start, fixed = true)
    "Tilt of the body, zero upright";
  Interfaces.RealOutput theta_m(unit = "rad", start = theta_m_start, fixed = true)
    "Angle of the wheels to the body, behind the gears";
  Interfaces.RealOutput omega_b(unit = "rad/s", start = omega_b_start, fixed = true)
    "Tilt rate";
  Interfaces.RealOutput omega_m(unit = "rad/s", start = omega_m_start, fixed = true)
    "Speed of the wheels to the body";
  Interfaces.RotationalPoint body "Torques between the body and the world, along theta_b";
  Interfaces.RotationalPoint motor "Torques between body and wheels, along theta_m";
equation
  der(theta_b) = omega_b;
  der(theta_m) = omega_m;
  body.phi = theta_b;
  motor.phi = theta_m;
  // Generalised forces of theta_m and of theta_b; the wheels turn by theta_m + theta_b.
  ((M_w + M_b) * r^2 + J_w + g_r^2 * J_m) * der(omega_m)
    + ((M_w + M_b) * r^2 + J_w + g_r * J_m + M_b * l * r * cos(theta_b)) * der(omega_b)
    - M_b * l * r * sin(theta_b) * omega_b^2 + c * omega_m = a * u + motor.tau;
  ((M_w + M_b) * r^2 + J_w + g_r * J_m + M_b * l * r * cos(theta_b)) * der(omega_m)
    + ((M_w + M_b) * r^2 + J_w + J_m + J_b + M_b * l^2 + 2 * M_b * l * r * cos(theta_b))
      * der(omega_b)
    - M_b * l * r * sin(theta_b) * omega_b^2 - M_b * g * l * sin(theta_b) = body.tau;

  annotation(Documentation(info = "<html>
  <p>Case 4 of the reference, (A.251) to (A.253), with <code>M_w</code>, <code>J_w</code> and
  <code>J_m</code> of both wheels together. The print has <code>a = 6.28e-7</code>; its (2.9)
  follows from <code>6.28e-2</code>. The state of (2.9) is <code>theta_b, theta_m</code> and their
  rates, not (2.1).</p>
  <p>Every term is proportional to a mass, an inertia, <code>c</code> or <code>a</code>, so
  recordings give ratios only, and the inertias cannot be told from the masses beside them:
  what a scale, a ruler or a data sheet gives (<code>M_w</code>, <code>M_b</code>,
  <code>r</code>, <code>g_r</code>, <code>a</code>) is known.</p>
  <h4>Reference</h4>
  <ul>
  <li>P. E. E. Shwe, <em>A Numerical Simulation Study of Data-driven Pole Placement</em>,
  dissertation, Kanazawa University (2017), chapter 2 and appendix A.4.4</li>
  </ul>
  </html>"));
end BalancingRobot2D;
