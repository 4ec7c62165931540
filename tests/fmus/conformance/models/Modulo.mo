model Modulo "mod"
  Real x(start = 0, fixed = true);
  Real y;
equation
  der(x) = mod(time, 0.23);
  y = mod(-time - 0.01, 0.3);
end Modulo;
