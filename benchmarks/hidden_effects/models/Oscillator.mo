model Oscillator "Mass on a spring, as a user of the toolkit would write it"
  parameter Real m(unit = "kg", min = 1e-3, nominal = 1) = 2.2 "Mass";
  parameter Real k(unit = "N/m", min = 0, nominal = 100) = 160 "Stiffness";
  parameter Real d(unit = "N.s/m", min = 0, nominal = 1) = 1 "Viscous friction coefficient";
  parameter Real s_start(unit = "m") = 0 "Position at the start";
  parameter Real v_start(unit = "m/s") = 0 "Velocity at the start";
  Twinproof.Interfaces.RealInput F(unit = "N") "Force of the shaker";
  Twinproof.Interfaces.RealOutput s(unit = "m", start = s_start, fixed = true) "Position";
  Real v(unit = "m/s", start = v_start, fixed = true) "Velocity";
  Twinproof.Interfaces.TranslationalPoint mass "Forces on the mass, along s";
equation
  der(s) = v;
  mass.s = s;
  m * der(v) = F - k * s - d * v + mass.f;
end Oscillator;
