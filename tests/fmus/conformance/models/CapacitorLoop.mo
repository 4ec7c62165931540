model CapacitorLoop "index 2: two capacitors in parallel"
  Real v1(start = 1, fixed = true);
  Real v2;
  Real i1;
  Real i2;
equation
  2 * der(v1) = i1;
  3 * der(v2) = i2;
  v1 = v2;
  i1 + i2 = -v1;
end CapacitorLoop;
