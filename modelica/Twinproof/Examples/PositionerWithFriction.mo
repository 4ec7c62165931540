within Twinproof.Examples;
model PositionerWithFriction "Positioner with dry friction and a constant force"
  extends Twinproof.Plants.Positioner(M = 95.1089, Fv = 203.5034);
  Twinproof.Effects.Translational.CoulombFriction coulombFriction(f_c = 20.3935)
    "Dry friction of the guide";
  Twinproof.Effects.Translational.ConstantForce constantForce(f_0 = 3.1648)
    "Offset of the amplifier";
equation
  connect(coulombFriction.flange, carriage.flange);
  connect(constantForce.flange, carriage.flange);

  annotation(Documentation(info = "<html>
  <p>Effects at a flange: extend the plant, declare the effects, connect them. Values are those
  published for the benchmark.</p>
  <h4>Reference</h4>
  <ul>
  <li>A. Janot, M. Gautier, M. Brunot, <em>Data set and reference models of EMPS</em>, Workshop on
  Nonlinear System Identification Benchmarks (2019)</li>
  </ul>
  </html>"));
end PositionerWithFriction;
