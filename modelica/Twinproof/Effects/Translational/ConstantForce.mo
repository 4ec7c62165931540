within Twinproof.Effects.Translational;
model ConstantForce "Constant force along s"
  extends Twinproof.Interfaces.TranslationalEffect;

  parameter Real f_0(unit = "N", nominal = 10) = 0 "Force along s, whatever the motion";
equation
  flange.f = -f_0;

  annotation(Documentation(info = "<html>
  <p>A positive <code>f_0</code> pushes towards larger <code>s</code>, as a slope, an
  unbalanced load or an amplifier offset does. <code>flange.f</code> counts what the machine
  gives to this component, hence the minus sign.</p>
  <h4>Reference</h4>
  <ul>
  <li>A. Janot, M. Gautier, M. Brunot, <em>Data set and reference models of EMPS</em>,
  Workshop on Nonlinear System Identification Benchmarks (2019) (its parameter OF, with the
  opposite sign)</li>
  </ul>
  </html>"));
end ConstantForce;
