within Workshop.Components;
model Torque "Input signal acting as external torque on a flange"
  Interfaces.RealInput tau(unit="N.m") "Accelerating torque acting at flange";
  Interfaces.Flange_b flange;
equation
  flange.tau = -tau;
end Torque;
