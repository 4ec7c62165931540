model HigherDerivatives "derivative of an algebraic expression"
  Real x(start = 1, fixed = true);
  Real y;
  Real w;
equation
  der(x) = -x;
  y = x ^ 2;
  w = der(y);
end HigherDerivatives;
