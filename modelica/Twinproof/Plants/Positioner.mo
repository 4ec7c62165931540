within Twinproof.Plants;
model Positioner "Carriage on a motor-driven ball screw: mass and viscous friction"
  parameter Real M(unit = "kg", min = 1e-3, nominal = 100) = 95.1089
    "Moving mass, with the rotor's inertia seen at the carriage";
  parameter Real Fv(unit = "N.s/m", min = 0, nominal = 100) = 203.5034
    "Viscous friction coefficient";
  parameter Real gtau(unit = "N/V", min = 1e-3, nominal = 10) = 35.1507
    "Force per volt of the drive" annotation(__twinproof(known = true));
  parameter Real q_start(unit = "m") = 0 "Position at the start";
  parameter Real v_start(unit = "m/s") = 0 "Velocity at the start";
  Interfaces.RealInput vir(unit = "V") "Voltage that commands the drive's current";
  Interfaces.RealOutput q(unit = "m", start = q_start, fixed = true) "Position of the carriage";
  Interfaces.RealOutput v(unit = "m/s", start = v_start, fixed = true) "Velocity of the carriage";
  Interfaces.TranslationalPoint carriage "Forces on the carriage, along q";
equation
  der(q) = v;
  carriage.s = q;
  M * der(v) = gtau * vir - Fv * v + carriage.f;

  annotation(Documentation(info = "<html>
  <p>The Electro-Mechanical Positioning System of the nonlinear identification benchmark, without
  its dry friction and offset. Only ratios to <code>gtau</code> can be fitted; the benchmark gives
  it.</p>
  <h4>Reference</h4>
  <ul>
  <li>A. Janot, M. Gautier, M. Brunot, <em>Data set and reference models of EMPS</em>, Workshop on
  Nonlinear System Identification Benchmarks (2019)</li>
  </ul>
  </html>"));
end Positioner;
