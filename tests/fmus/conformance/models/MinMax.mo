model MinMax "min and max of scalars"
  Real x(start = 0, fixed = true);
equation
  der(x) = min(2 * time, 1) + max(0, time - 0.7);
end MinMax;
