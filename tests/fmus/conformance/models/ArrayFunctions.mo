model ArrayFunctions "sum, product, min, max, size, zeros, ones, fill, identity, diagonal, linspace, cross"
  Real x[3];
  Real s;
  Real p;
  Real m;
  Real n;
  Real c[3];
  Real d[3];
  Real e[3];
equation
  x = {1 + time, 2, 3 - time};
  s = sum(x) + size(x, 1) + sum(zeros(3)) + sum(ones(2)) + sum(fill(time, 2));
  p = product(x);
  m = max(x);
  n = min(x);
  c = cross(x, {1.0, 0.0, 2.0});
  d = diagonal({1.0, 2.0, 3.0}) * x + identity(3) * x;
  e = linspace(0.0, 1.0, 3) * time;
end ArrayFunctions;
