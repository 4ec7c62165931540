model Smooth "smooth"
  Real x(start = -1, fixed = true);
equation
  der(x) = 1 + smooth(1, if x > 0 then x ^ 2 else 0);
end Smooth;
