model TypesAndUnits "types with unit, min, max, nominal; protected variables"
  type Angle = Real(unit = "rad", displayUnit = "deg");
  Angle phi(start = 1, fixed = true, min = -10, max = 10, nominal = 0.1);
protected
  Real w(start = 0, fixed = true, unit = "rad/s");
equation
  der(phi) = w;
  der(w) = -9 * phi;
end TypesAndUnits;
