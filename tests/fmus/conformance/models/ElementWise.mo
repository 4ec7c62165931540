model ElementWise "element-wise operators and functions of arrays"
  Real x[3];
  Real y[3];
  Real z[3];
equation
  x = {1, 2, 3} * time;
  y = x .* x ./ (1 .+ x) .^ 2;
  z = sin(x) - x / 2;
end ElementWise;
