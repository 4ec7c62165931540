model Comprehension "array constructor with iterator"
  parameter Real k[3] = {i ^ 2 for i in 1:3};
  Real y[3];
  Real s;
equation
  y = {k[i] * time + i for i in 1:3};
  s = sum(i * y[i] for i in 1:3);
end Comprehension;
