model EnumerationParameter "parameter of an enumeration type"
  type Shape = enumeration(flat, linear, steep);
  parameter Shape shape = Shape.linear;
  Real x(start = 0, fixed = true);
equation
  der(x) = if shape == Shape.flat then 0 elseif shape == Shape.linear then 1 else 5;
end EnumerationParameter;
