model MatrixProduct "matrices and their products"
  parameter Real A[2, 2] = [-1, 2; 0, -3];
  Real x[2](start = {1, 2}, each fixed = true);
  Real y[2];
  Real q;
equation
  der(x) = A * x;
  y = transpose(A) * x;
  q = x * A * x;
end MatrixProduct;
