model Rounding "floor, ceil and integer"
  Real a;
  Real b;
  Integer i;
equation
  a = floor(5 * time + 0.03);
  b = ceil(5 * time + 0.03);
  i = integer(7 * time + 0.03);
end Rounding;
