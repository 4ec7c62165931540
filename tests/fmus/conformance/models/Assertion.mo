model Assertion "assert that holds"
  Real x(start = 0, fixed = true);
equation
  der(x) = 1;
  assert(x < 2, "x is too large");
end Assertion;
