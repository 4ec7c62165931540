model DuffingCircuit "Analogue circuit of a mass on a linear spring; one volt stands for a metre"
  parameter Real m(unit = "kg", min = 1e-7, nominal = 1e-5) = 5e-6 "Mass";
  parameter Real c(unit = "N.s/m", min = 0, nominal = 1e-4) = 2e-4 "Damping";
  parameter Real k(unit = "N/m", min = 0, nominal = 1) = 1 "Stiffness";
  parameter Real y_start(unit = "m") = 0 "Position at the start";
  parameter Real v_start(unit = "m/s") = 0 "Velocity at the start";
  Twinproof.Interfaces.RealInput u(unit = "N") "Force: voltage V1";
  Twinproof.Interfaces.RealOutput y(unit = "m", start = y_start, fixed = true)
    "Position: voltage V2";
  Real v(unit = "m/s", start = v_start, fixed = true) "Velocity";
  Twinproof.Interfaces.TranslationalPoint mass "Forces on the mass, along y";
equation
  der(y) = v;
  mass.s = y;
  m * der(v) = u - c * v - k * y + mass.f;
end DuffingCircuit;
