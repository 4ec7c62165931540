within Twinproof.Plants;
model BalancingRobot3D "Self-balancing robot that drives and turns"
  parameter Real M_w(unit = "kg", min = 1e-3, nominal = 0.1) = 0.07 "Mass of one wheel"
    annotation(__twinproof(known = true));
  parameter Real M_b(unit = "kg", min = 1e-3, nominal = 1) = 0.5 "Mass of the body"
    annotation(__twinproof(known = true));
  parameter Real J_w(unit = "kg.m2", min = 0, nominal = 1e-4) = 8.75e-5 "Inertia of one wheel";
  parameter Real J_b(unit = "kg.m2", min = 0, nominal = 1e-3) = 6.7e-3
    "Inertia of the body in pitch, about its centre of mass";
  parameter Real J_phi(unit = "kg.m2", min = 0, nominal = 1e-3) = 6e-4
    "Inertia of the body in yaw";
  parameter Real J_m(unit = "kg.m2", min = 0, nominal = 1e-4) = 1.3e-4 "Inertia of one rotor";
  parameter Real l(unit = "m", min = 1e-3, nominal = 0.1) = 0.1073
    "Distance of the body's centre of mass from the axle";
  parameter Real d(unit = "m", min = 1e-3, nominal = 0.1) = 0.06
    "Distance of a wheel from the middle of the axle" annotation(__twinproof(known = true));
  parameter Real r(unit = "m", min = 1e-3, nominal = 0.03) = 0.025 "Radius of the wheels"
    annotation(__twinproof(known = true));
  parameter Real g_r(unit = "1", min = 1, nominal = 30) = 30 "Gear ratio"
    annotation(__twinproof(known = true));
  parameter Real K_t(unit = "N.m/A", min = 1e-4, nominal = 0.01) = 0.02
    "Torque constant of a motor, equal to its back-EMF constant in V.s/rad"
    annotation(__twinproof(known = true));
  parameter Real R_m(unit = "Ohm", min = 1e-4, nominal = 1) = 0.035 "Resistance of a motor"
    annotation(__twinproof(known = true));
  parameter Real d_m(unit = "N.m.s/rad", min = 0, nominal = 1e-3) = 0.0022
    "Viscous friction coefficient at a motor's shaft";
  parameter Real d_w(unit = "N.m.s/rad", min = 0, nominal = 1e-2) = 0
    "Viscous friction coefficient between a wheel and the floor";
  parameter Real g(unit = "m/s2", min = 9.7, nominal = 9.81) = 9.81 "Acceleration of gravity"
    annotation(__twinproof(known = true));
  parameter Real theta_w_start(unit = "rad") = 0 "Mean wheel angle at the start";
  parameter Real theta_b_start(unit = "rad") = 0 "Pitch at the start";
  parameter Real phi_start(unit = "rad") = 0 "Yaw at the start";
  parameter Real omega_w_start(unit = "rad/s") = 0 "Mean wheel speed at the start";
  parameter Real omega_b_start(unit = "rad/s") = 0 "Pitch rate at the start";
  parameter Real omega_phi_start(unit = "rad/s") = 0 "Yaw rate at the start";
  Interfaces.RealInput u1(unit = "V") "Sum of the motor voltages, right plus left";
  Interfaces.RealInput u2(unit = "V") "Difference of the motor voltages, right minus left";
  Interfaces.RealOutput theta_w(unit = "rad", start = theta_w_start, fixed = true)
    "Mean of the wheel angles, against the vertical";
  Interfaces.RealOutput theta_b(unit = "rad", start = theta_b_start, fixed = true)
    "Pitch of the body, zero upright";
  Interfaces.RealOutput phi(unit = "rad", start = phi_start, fixed = true) "Yaw";
  Interfaces.RealOutput omega_w(unit = "rad/s", start = omega_w_start, fixed = true)
    "Mean of the wheel speeds";
  Interfaces.RealOutput omega_b(unit = "rad/s", start = omega_b_start, fixed = true)
    "Pitch rate";
  Interfaces.RealOutput omega_phi(unit = "rad/s", start = omega_phi_start, fixed = true)
    "Yaw rate";
  Interfaces.RotationalPoint wheel "Torques between both wheels and the world, along theta_w";
  Interfaces.RotationalPoint body "Torques between the body and the world, along theta_b";
  Interfaces.RotationalPoint yaw "Torques about the vertical, along phi";
  Real tau_m(unit = "N.m") "Torque of both motors and their friction on the wheels";
protected
  final parameter Real b_v(unit = "N.m/V") = g_r * K_t / R_m
    "Torque of one motor on its wheel per volt";
  final parameter Real d_b(unit = "N.m.s/rad") = g_r^2 * K_t^2 / R_m + g_r * d_m
    "Back-EMF and friction of one motor, seen at its wheel";
equation
  der(theta_w) = omega_w;
  der(theta_b) = omega_b;
  der(phi) = omega_phi;
  wheel.phi = theta_w;
  body.phi = theta_b;
  yaw.phi = phi;
  tau_m = b_v * u1 - 2 * d_b * (omega_w - omega_b);
  ((2 * M_w + M_b) * r^2 + 2 * J_w + 2 * g_r^2 * J_m) * der(omega_w)
    + (M_b * l * r * cos(theta_b) - 2 * g_r^2 * J_m) * der(omega_b)
    - M_b * l * r * sin(theta_b) * omega_b^2 + 2 * d_w * omega_w = tau_m + wheel.tau;
  (M_b * l * r * cos(theta_b) - 2 * g_r^2 * J_m) * der(omega_w)
    + (M_b * l^2 + J_b + 2 * g_r^2 * J_m) * der(omega_b)
    - M_b * l * sin(theta_b) * (g + l * cos(theta_b) * omega_phi^2) = -tau_m + body.tau;
  (2 * M_w * d^2 + J_phi + 2 * (d / r)^2 * (J_w + g_r^2 * J_m) + M_b * l^2 * sin(theta_b)^2)
      * der(omega_phi)
    + 2 * M_b * l^2 * sin(theta_b) * cos(theta_b) * omega_b * omega_phi
    + 2 * (d / r)^2 * (d_b + d_w) * omega_phi = d / r * b_v * u2 + yaw.tau;

  annotation(Documentation(info = "<html>
  <p>Case 1 of the reference with its motor (A.38) to (A.48), without inductance. The inputs are
  those of (3.26): <code>u1 = v_r + v_l</code>, <code>u2 = v_r - v_l</code>, without the 1/2 of
  (A.55), so the input gain is <code>b_v</code> and not <code>2*b_v</code>; <code>d_b</code> is
  (A.48), not (A.161). With the printed parameters this gives (3.31), of which the element
  3.5299 is a misprint for 3.5399.</p>
  <p>The reference lets the friction of the floor, <code>d_w</code>, act back on the body as if it
  were the motor's; here it acts on the wheels alone. It is zero in all its figures.</p>
  <p>Every term is proportional to a mass, an inertia, a friction or <code>K_t</code>, so
  recordings give ratios only, and the inertias cannot be told from the masses beside them:
  masses, lengths and the motors' data are known.</p>
  <h4>Reference</h4>
  <ul>
  <li>P. E. E. Shwe, <em>A Numerical Simulation Study of Data-driven Pole Placement</em>,
  dissertation, Kanazawa University (2017), chapter 3 and appendix A.2.1</li>
  </ul>
  </html>"));
end BalancingRobot3D;
