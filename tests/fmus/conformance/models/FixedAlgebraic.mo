model FixedAlgebraic "fixed start of a variable that is no state"
  Real x(start = 0.1);
  Real y(start = 8, fixed = true);
equation
  der(x) = -x;
  y = x ^ 3 + x + 6;
end FixedAlgebraic;
