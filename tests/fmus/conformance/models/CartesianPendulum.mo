model CartesianPendulum "index 3: pendulum in Cartesian coordinates"
  Real x(start = 0.6, fixed = true);
  Real y(start = -0.8);
  Real vx(start = 0, fixed = true);
  Real vy;
  Real f;
equation
  der(x) = vx;
  der(y) = vy;
  der(vx) = f * x;
  der(vy) = f * y - 9.81;
  x ^ 2 + y ^ 2 = 1;
end CartesianPendulum;
