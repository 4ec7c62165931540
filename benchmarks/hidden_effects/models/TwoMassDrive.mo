model TwoMassDrive "Motor and load on an elastic shaft, as a user of the toolkit would write it"
  parameter Real J1(unit = "kg.m2", min = 1e-6, nominal = 0.01) = 0.022 "Inertia of the motor";
  parameter Real J2(unit = "kg.m2", min = 1e-6, nominal = 0.01) = 0.055 "Inertia of the load";
  parameter Real k(unit = "N.m/rad", min = 0, nominal = 10) = 14 "Stiffness of the shaft";
  parameter Real d(unit = "N.m.s/rad", min = 0, nominal = 0.01) = 0.03 "Damping of the shaft";
  parameter Real d1(unit = "N.m.s/rad", min = 0, nominal = 0.1) = 0.04 "Friction of the motor";
  parameter Real d2(unit = "N.m.s/rad", min = 0, nominal = 0.1) = 0.06 "Friction of the load";
  parameter Real phi_1_start(unit = "rad") = 0 "Angle of the motor at the start";
  parameter Real phi_2_start(unit = "rad") = 0 "Angle of the load at the start";
  parameter Real w_1_start(unit = "rad/s") = 0 "Speed of the motor at the start";
  parameter Real w_2_start(unit = "rad/s") = 0 "Speed of the load at the start";
  Twinproof.Interfaces.RealInput tau(unit = "N.m") "Torque of the motor";
  Twinproof.Interfaces.RealOutput phi_1(unit = "rad", start = phi_1_start, fixed = true)
    "Angle of the motor";
  Twinproof.Interfaces.RealOutput phi_2(unit = "rad", start = phi_2_start, fixed = true)
    "Angle of the load";
  Real w_1(unit = "rad/s", start = w_1_start, fixed = true) "Speed of the motor";
  Real w_2(unit = "rad/s", start = w_2_start, fixed = true) "Speed of the load";
  Twinproof.Interfaces.RotationalPoint motor "Torques on the motor, along phi_1";
  Twinproof.Interfaces.RotationalPoint load "Torques on the load, along phi_2";
equation
  der(phi_1) = w_1;
  der(phi_2) = w_2;
  motor.phi = phi_1;
  load.phi = phi_2;
  J1 * der(w_1) = tau - k * (phi_1 - phi_2) - d * (w_1 - w_2) - d1 * w_1 + motor.tau;
  J2 * der(w_2) = k * (phi_1 - phi_2) + d * (w_1 - w_2) - d2 * w_2 + load.tau;
end TwoMassDrive;
