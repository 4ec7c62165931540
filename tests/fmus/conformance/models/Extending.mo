model Extending "extends, with modifiers"
  extends Middle(k = 4, x(start = 3));
equation
  der(x) = r;
end Extending;

partial model Base
  parameter Real k = 1;
  Real x(start = 1, fixed = true);
end Base;

model Middle
  extends Base(k = 2);
  Real r;
equation
  r = -k * x;
end Middle;
