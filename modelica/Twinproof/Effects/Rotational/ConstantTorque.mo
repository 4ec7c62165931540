within Twinproof.Effects.Rotational;
model ConstantTorque "Constant torque along phi"
  extends Twinproof.Interfaces.RotationalEffect;

  parameter Real tau_0(unit = "N.m", nominal = 0.1) = 0 "Torque along phi, whatever the motion";
equation
  flange.tau = -tau_0;

  annotation(Documentation(info = "<html>
  <p>A positive <code>tau_0</code> pushes towards larger <code>phi</code>, as a slope, an
  unbalanced load or an amplifier offset does. <code>flange.tau</code> counts what the machine
  gives to this component, hence the minus sign.</p>
  <h4>Reference</h4>
  <ul>
  <li>A. Janot, M. Gautier, M. Brunot, <em>Data set and reference models of EMPS</em>,
  Workshop on Nonlinear System Identification Benchmarks (2019) (its parameter OF, with the
  opposite sign)</li>
  </ul>
  </html>"));
end ConstantTorque;
