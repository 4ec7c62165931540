model LinearLoop "large linear loop"
  parameter Integer n = 12;
  Real v[n];
equation
  3 * v[1] - v[2] = sin(time);
  for i in 2:n - 1 loop
    3 * v[i] - v[i - 1] - v[i + 1] = 0;
  end for;
  3 * v[n] - v[n - 1] = 1;
end LinearLoop;
