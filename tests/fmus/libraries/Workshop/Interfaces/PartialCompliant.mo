within Workshop.Interfaces;
partial model PartialCompliant "Compliant connection of two flanges"
  extends PartialTwoFlanges;
  SI.Angle phi_rel(start=0) "Relative rotation angle (= flange_b.phi - flange_a.phi)";
  SI.Torque tau "Torque between flanges (= flange_b.tau)";
protected
  import Workshop.Units.SI;
equation
  phi_rel = flange_b.phi - flange_a.phi;
  flange_b.tau = tau;
  flange_a.tau = -tau;
end PartialCompliant;
