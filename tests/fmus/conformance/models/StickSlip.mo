model StickSlip "dry friction with sign: stick and slip"
  Real x(start = 0, fixed = true);
  Real v(start = 1, fixed = true);
equation
  der(x) = v;
  der(v) = 0.5 - 2 * sign(v);
end StickSlip;
