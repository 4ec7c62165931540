model FrictionlessPendulum "Pendulum driven by a torque, without any loss"
  parameter Real J(unit = "kg.m2", min = 1e-3, nominal = 0.1) = 0.15 "Inertia about the joint";
  parameter Real mgl(unit = "N.m", min = 0, nominal = 1) = 3
    "Weight times distance of the centre of mass from the joint";
  parameter Real theta_start(unit = "rad") = 0 "Angle at the start";
  parameter Real omega_start(unit = "rad/s") = 0 "Angular velocity at the start";
  Twinproof.Interfaces.RealInput tau(unit = "N.m") "Motor torque";
  Twinproof.Interfaces.RealOutput theta(unit = "rad", start = theta_start, fixed = true)
    "Angle, zero hanging";
  Twinproof.Interfaces.RealOutput omega(unit = "rad/s", start = omega_start, fixed = true)
    "Angular velocity";
  Twinproof.Interfaces.RotationalPoint joint "Torques on the joint, along theta";
equation
  der(theta) = omega;
  joint.phi = theta;
  J * der(omega) = tau - mgl * sin(theta) + joint.tau;
end FrictionlessPendulum;
