model Homotopy "homotopy: the actual expression"
  Real x(start = 1, fixed = true);
equation
  der(x) = -homotopy(x ^ 2, x);
end Homotopy;
