within Twinproof.Plants;
model WheeledPendulum "Wheel-driven inverted pendulum, in parameters lumped to volts"
  parameter Real X1(unit = "V.s2/rad", min = 0, nominal = 0.05) = 0.0436
    "Inertia of the wheels and of the mass they carry, ((2*m + M)*R^2 + 2*J_w)/alpha";
  parameter Real X2(unit = "V.s2/rad", min = 0, nominal = 0.02) = 0.0178
    "Inertia of the motors seen through their gears, 2*eps^2*J_m/alpha";
  parameter Real X3(unit = "V.s2/rad", min = 0, nominal = 0.1) = 0.1149
    "Coupling of wheel and body, M*L*R/alpha";
  parameter Real X4(unit = "V.s2/rad", min = 0, nominal = 1) = 0.8719
    "Inertia of the body about the axle, (M*L^2 + J_b)/alpha";
  parameter Real X5(unit = "V", min = 0, nominal = 5) = 4.6701
    "Weight of the body, M*g*L/alpha";
  parameter Real X6(unit = "V.s/rad", min = 0, nominal = 1) = 0.7268
    "Back-EMF and friction on the wheel's speed, 2*(beta + f_w)/alpha";
  parameter Real X7(unit = "V.s/rad", min = 0, nominal = 1) = 0.7256
    "Back-EMF and friction on the body's speed, 2*beta/alpha";
  parameter Real alpha(unit = "N.m/V", min = 1e-3, nominal = 100) = 165.418
    "Motor torque per volt at standstill, 2*eps*K_t/R_m" annotation(__twinproof(known = true));
  parameter Real theta_w_start(unit = "rad") = 0 "Wheel angle at the start";
  parameter Real theta_p_start(unit = "rad") = 0 "Pitch at the start";
  parameter Real omega_w_start(unit = "rad/s") = 0 "Wheel speed at the start";
  parameter Real omega_p_start(unit = "rad/s") = 0 "Pitch rate at the start";
  Interfaces.RealInput V(unit = "V") "Motor voltage";
  Interfaces.RealOutput theta_w(unit = "rad", start = theta_w_start, fixed = true)
    "Wheel angle, against the vertical";
  Interfaces.RealOutput theta_p(unit = "rad", start = theta_p_start, fixed = true)
    "Pitch of the body, zero upright";
  Interfaces.RealOutput omega_w(unit = "rad/s", start = omega_w_start, fixed = true)
    "Wheel speed";
  Interfaces.RealOutput omega_p(unit = "rad/s", start = omega_p_start, fixed = true)
    "Pitch rate";
  Interfaces.RotationalPoint wheel "Torques between the wheel and the world, along theta_w";
  Interfaces.RotationalPoint body "Torques between the body and the world, along theta_p";
equation
  der(theta_w) = omega_w;
  der(theta_p) = omega_p;
  wheel.phi = theta_w;
  body.phi = theta_p;
  // Generalised forces of theta_w and of theta_p; the second is written with the sign of (20).
  V + wheel.tau / alpha = (X1 + X2) * der(omega_w) + (X3 * cos(theta_p) - X2) * der(omega_p)
    - X3 * omega_p^2 * sin(theta_p) + X6 * omega_w - X7 * omega_p;
  V - body.tau / alpha = -(X3 * cos(theta_p) - X2) * der(omega_w) - (X4 + X2) * der(omega_p)
    + X5 * sin(theta_p) + X6 * omega_w - X7 * omega_p;

  annotation(Documentation(info = "<html>
  <p>Equations (19) and (20) of the paper, which follow from the Lagrangian (1) and a motor without
  inductance. The print of (20) has <code>-X5*sin(theta_p)</code>; gravity makes it <code>+</code>.
  The exponent of eps in X2 is that of (14). Defaults are the paper's; the length that reproduces
  X3, X4 and X5 is 0.716 m.</p>
  <p>Attached torques are in N.m and are divided by <code>alpha</code>. Since X1 to X7 are ratios to
  it, recordings of voltage and motion say nothing about <code>alpha</code>: it is known, not
  fitted.</p>
  <h4>Reference</h4>
  <ul>
  <li>C.-C. Peng, N.-J. Cheng, M.-C. Tsai, <em>Application of an Output Filtering Method for an
  Unstable Wheel-Driven Pendulum System Parameter Identification</em>, Electronics 12 (2023)
  4569</li>
  </ul>
  </html>"));
end WheeledPendulum;
