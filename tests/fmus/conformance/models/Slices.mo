model Slices "slices of arrays"
  Real x[4](start = {1, 2, 3, 4}, each fixed = true);
  Real y[2];
  Real z;
equation
  der(x[1:2]) = -x[3:4];
  der(x[3:4]) = x[1:2];
  y = x[{2, 4}];
  z = x[end];
end Slices;
