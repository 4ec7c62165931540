within Twinproof.Plants;
model Pendulum "Pendulum driven by a torque at its joint"
  parameter Real J(unit = "kg.m2", min = 1e-6, nominal = 0.1) = 0.185
    "Inertia about the joint";
  parameter Real mgl(unit = "N.m", min = 0, nominal = 1) = 3.61
    "Weight times distance of the centre of mass from the joint";
  parameter Real d(unit = "N.m.s/rad", min = 0, nominal = 0.01) = 0.006
    "Viscous friction coefficient of the joint";
  parameter Real theta_start(unit = "rad") = 0 "Angle at the start";
  parameter Real omega_start(unit = "rad/s") = 0 "Angular velocity at the start";
  Interfaces.RealInput tau(unit = "N.m") "Motor torque";
  Interfaces.RealOutput theta(unit = "rad", start = theta_start, fixed = true)
    "Angle, zero hanging";
  Interfaces.RealOutput omega(unit = "rad/s", start = omega_start, fixed = true)
    "Angular velocity";
  Interfaces.RotationalPoint joint "Torques on the joint, along theta";
equation
  der(theta) = omega;
  joint.phi = theta;
  J * der(omega) = tau - mgl * sin(theta) - d * omega + joint.tau;

  annotation(Documentation(info = "<html>
  <p>The defaults describe the test bench of the second reference.</p>
  <h4>Reference</h4>
  <ul>
  <li>L. Meirovitch, <em>Fundamentals of Vibrations</em> (2001)</li>
  <li>F. Wiebe et al., <em>Torque-limited simple pendulum: A toolkit for getting familiar with
  control algorithms in underactuated robotics</em>, Journal of Open Source Software 7 (2022)
  3884</li>
  </ul>
  </html>"));
end Pendulum;
