model BooleanLogic "Boolean variables and operators"
  Boolean a;
  Boolean b;
  Boolean c;
  Real x(start = 0, fixed = true);
equation
  a = time > 0.31;
  b = time > 0.73;
  c = a and not b or time > 0.97;
  der(x) = if c then 1 else 0;
end BooleanLogic;
