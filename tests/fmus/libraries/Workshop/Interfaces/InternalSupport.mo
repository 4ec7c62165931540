within Workshop.Interfaces;
model InternalSupport "Adapter to use a support flange that may be absent"
  input Units.SI.Torque tau "External support torque";
  Units.SI.Angle phi "External support angle (= flange.phi)";
  Flange_a flange "Internal support flange";
equation
  flange.tau = tau;
  flange.phi = phi;
end InternalSupport;
