model NonlinearSystem "system of nonlinear equations, with a second one behind it"
  Real x(start = 1, fixed = true);
  Real a(start = 1);
  Real b(start = 1);
  Real c(start = 0.3);
equation
  der(x) = -c;
  a ^ 2 + b = 2 + x;
  a - exp(-b) = 0.5;
  c + sin(c) = a * b;
end NonlinearSystem;
