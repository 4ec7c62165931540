model Stiff "stiff: rates that differ by a factor of a million"
  Real x(start = 1, fixed = true);
  Real y(start = 2, fixed = true);
equation
  der(x) = -1e6 * (x - cos(time)) - sin(time);
  der(y) = -y + x;
end Stiff;
