model Constants "constants, parameters, final parameters"
  constant Real c = 2;
  parameter Real k = 3;
  final parameter Real h = 0.5;
  Real x(start = 1, fixed = true);
equation
  der(x) = -k * x + c * h;
end Constants;
