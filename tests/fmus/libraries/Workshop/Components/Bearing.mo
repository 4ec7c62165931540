within Workshop.Components;
model Bearing "Friction against the housing, of a kind that can be exchanged"
  replaceable model Law = Viscous constrainedby PartialLaw "Law of friction"
    annotation (choicesAllMatching=true);
  parameter Boolean useSupport=false "= true, if the housing is a flange of its own"
    annotation (Evaluate=true);
  Interfaces.Flange_a flange_a;
  Interfaces.Flange_b support if useSupport;
  Law law;
protected
  Interfaces.InternalSupport housing(tau=-flange_a.tau);
  Fixed fixed if not useSupport;
  Units.SI.Angle phi_rel "Of the shaft, relative to the housing";
equation
  connect(housing.flange, support);
  connect(housing.flange, fixed.flange);
  phi_rel = flange_a.phi - housing.phi;
  law.w = der(phi_rel);
  flange_a.tau = law.tau;

public
  partial model PartialLaw "Torque as function of speed"
    Units.SI.AngularVelocity w;
    Units.SI.Torque tau;
  end PartialLaw;

  model Viscous
    extends PartialLaw;
    parameter Units.SI.RotationalDampingConstant d = 0.1;
  equation
    tau = d*w;
  end Viscous;

  model Dry
    extends PartialLaw;
    parameter Units.SI.Torque T = 0.2;
  equation
    tau = T*Math.rounded(w, width=0.05);
  end Dry;
end Bearing;
