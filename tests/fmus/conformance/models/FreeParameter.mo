model FreeParameter "parameter with fixed = false, and one that follows from it"
  parameter Real k(fixed = false, start = 1);
  parameter Real twice = 2 * k;
  Real x(start = 1, fixed = true);
initial equation
  k ^ 3 + k = 10;
equation
  der(x) = -twice * x;
end FreeParameter;
