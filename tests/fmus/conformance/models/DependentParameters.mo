model DependentParameters "parameters that follow from parameters"
  parameter Real a = 2;
  parameter Real b = a ^ 2 + 1;
  parameter Real c = sqrt(b - 1) * b;
  Real x(start = c, fixed = true);
equation
  der(x) = -x / b;
end DependentParameters;
