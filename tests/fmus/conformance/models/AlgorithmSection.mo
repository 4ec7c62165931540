model AlgorithmSection "algorithm section in a model"
  Real x(start = 1, fixed = true);
  Real y;
algorithm
  y := 2 * x;
  y := y + 1;
equation
  der(x) = -y;
end AlgorithmSection;
