within Twinproof.Plants;
model FurutaPendulum "Rotary inverted pendulum: a motor turns an arm, the rod at its end is free"
  parameter Real J_z0(unit = "kg.m2", min = 0, nominal = 1e-3) = 0.0035
    "Inertia of the arm about the motor's axis, with the motor's";
  parameter Real J_r1(unit = "kg.m2", min = 1e-6, nominal = 1e-3) = 0.79e-3
    "Inertia of the rod about its pivot";
  parameter Real m1(unit = "kg", min = 1e-3, nominal = 0.03) = 0.0276
    "Mass of the rod and its weight" annotation(__twinproof(known = true));
  parameter Real l0(unit = "m", min = 1e-3, nominal = 0.1) = 0.1505
    "Distance of the rod's pivot from the motor's axis" annotation(__twinproof(known = true));
  parameter Real l1(unit = "m", min = 1e-3, nominal = 0.1) = 0.145
    "Distance of the rod's centre of mass from its pivot" annotation(__twinproof(known = true));
  parameter Real C0(unit = "N.m.s/rad", min = 0, nominal = 0.01) = 0.0169
    "Viscous friction coefficient of the arm";
  parameter Real C1(unit = "N.m.s/rad", min = 0, nominal = 1e-4) = 1e-4
    "Viscous friction coefficient of the rod";
  parameter Real K_f(unit = "N.m", min = 0, nominal = 0.01) = 0.0351
    "Coulomb friction torque of the arm";
  parameter Real K_t(unit = "N.m/A", min = 1e-4, nominal = 0.1) = 0.0706
    "Torque constant of the motor" annotation(__twinproof(known = true));
  parameter Real K_b(unit = "V.s/rad", min = 1e-4, nominal = 0.1) = 0.0707
    "Back-EMF constant of the motor" annotation(__twinproof(known = true));
  parameter Real K_u(unit = "V", min = 1e-4, nominal = 0.1) = 0.0618
    "Voltage of the amplifier per count" annotation(__twinproof(known = true));
  parameter Real R_a(unit = "Ohm", min = 1e-3, nominal = 1) = 0.9 "Resistance of the motor"
    annotation(__twinproof(known = true));
  parameter Real g(unit = "m/s2", min = 9.7, nominal = 9.81) = 9.81 "Acceleration of gravity"
    annotation(__twinproof(known = true));
  parameter Real w_0(unit = "rad/s", min = 1e-4, nominal = 0.05) = 1 / 15
    "Speed at which the smoothed sign has reached 76 %" annotation(__twinproof(known = true));
  parameter Real alpha_start(unit = "rad") = 0 "Angle of the arm at the start";
  parameter Real beta_start(unit = "rad") = 0 "Angle of the rod at the start";
  parameter Real omega_alpha_start(unit = "rad/s") = 0 "Angular velocity of the arm at the start";
  parameter Real omega_beta_start(unit = "rad/s") = 0 "Angular velocity of the rod at the start";
  Interfaces.RealInput u(unit = "1") "Counts sent to the amplifier";
  Interfaces.RealOutput alpha(unit = "rad", start = alpha_start, fixed = true)
    "Angle of the arm";
  Interfaces.RealOutput beta(unit = "rad", start = beta_start, fixed = true)
    "Angle of the rod, zero hanging";
  Interfaces.RealOutput omega_alpha(unit = "rad/s", start = omega_alpha_start, fixed = true)
    "Angular velocity of the arm";
  Interfaces.RealOutput omega_beta(unit = "rad/s", start = omega_beta_start, fixed = true)
    "Angular velocity of the rod";
  Interfaces.RotationalPoint arm "Torques between the arm and the world, along alpha";
  Interfaces.RotationalPoint rod "Torques at the pivot of the rod, along beta";
equation
  der(alpha) = omega_alpha;
  der(beta) = omega_beta;
  arm.phi = alpha;
  rod.phi = beta;
  (J_z0 + m1 * l0^2 + m1 * l1^2 * sin(beta)^2) * der(omega_alpha)
    + m1 * l0 * l1 * cos(beta) * der(omega_beta)
    + 2 * m1 * l1^2 * sin(beta) * cos(beta) * omega_alpha * omega_beta
    - m1 * l0 * l1 * sin(beta) * omega_beta^2
    + (C0 + K_t * K_b / R_a) * omega_alpha + K_f * tanh(omega_alpha / w_0)
    = K_t * K_u / R_a * u + arm.tau;
  m1 * l0 * l1 * cos(beta) * der(omega_alpha) + J_r1 * der(omega_beta)
    - m1 * l1^2 * sin(beta) * cos(beta) * omega_alpha^2
    + C1 * omega_beta + m1 * g * l1 * sin(beta) = rod.tau;

  annotation(Documentation(info = "<html>
  <p>Equation (2.23) of the report with <code>J_r1 = J_z1 + m1*l1^2</code> and two misprints
  corrected: the motor's terms are <code>K_t*K_b</code> and <code>K_t*K_u</code>. The
  <code>l0</code> of 0.1505 m, instead of the 0.1547 m of its Table 4.2, reproduces (5.4). Defaults
  are setup 1, least squares. The smoothed sign is its (2.20), <code>k = 15</code>.</p>
  <p>Recordings of angles give ratios to the motor's torque; of the arm's viscous friction and the
  back-EMF they give the sum, of the rod's weight and <code>J_r1</code> the ratio. So the motor's
  data, <code>m1</code>, <code>l0</code> and <code>l1</code> are known.</p>
  <p>What the report found beyond this model is added where it acts: stiction is a
  <a href=\"modelica://Twinproof.Effects.Rotational.StribeckFriction\">StribeckFriction</a> at
  <code>arm</code>, the amplifier's dead zone a
  <a href=\"modelica://Twinproof.Effects.Signal.DeadZone\">DeadZone</a> at <code>u</code> (45 counts
  are 0.218 N.m, and <code>K_f</code> is only 7 counts, so they are two effects), friction that
  differs between directions an
  <a href=\"modelica://Twinproof.Effects.Rotational.AsymmetricViscousFriction\"
  >AsymmetricViscousFriction</a> at <code>arm</code>.</p>
  <h4>Reference</h4>
  <ul>
  <li>M. B. Arnolds, <em>Identification and control of the Rotary Inverted Pendulum</em>, report
  DCT 2003.100, Technische Universiteit Eindhoven (2003)</li>
  </ul>
  </html>"));
end FurutaPendulum;
