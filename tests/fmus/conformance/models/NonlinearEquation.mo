model NonlinearEquation "nonlinear equation"
  Real x(start = 1, fixed = true);
  Real y(start = 0.5);
equation
  der(x) = -y;
  y ^ 3 + y = x;
end NonlinearEquation;
