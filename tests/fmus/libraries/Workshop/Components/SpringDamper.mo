within Workshop.Components;
model SpringDamper "Linear spring and damper in parallel"
  extends Interfaces.PartialCompliant;
  parameter SI.RotationalSpringConstant c(final min=0, start=1.0e5) "Spring constant";
  parameter SI.RotationalDampingConstant d(final min=0, start=0) "Damping constant";
  parameter SI.Angle phi_rel0=0 "Unstretched spring angle";
protected
  SI.Torque tau_c "Spring torque";
  SI.Torque tau_d "Damping torque";
equation
  tau_c = c*(phi_rel - phi_rel0);
  tau_d = d*der(phi_rel);
  tau = tau_c + tau_d;
end SpringDamper;
