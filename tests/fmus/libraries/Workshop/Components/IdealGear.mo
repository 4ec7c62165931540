within Workshop.Components;
model IdealGear "Ideal gear without inertia"
  extends Interfaces.PartialTwoFlanges;
  parameter Real ratio(start=1) "Transmission ratio (flange_a.phi/flange_b.phi)";
equation
  flange_a.phi = ratio*flange_b.phi;
  0 = ratio*flange_a.tau + flange_b.tau;
end IdealGear;
