model IntegerVariables "Integer variables"
  Integer i;
  Integer j;
  Real x(start = 0, fixed = true);
equation
  i = if time > 0.51 then 3 else 1;
  j = 2 * i + 1;
  der(x) = j;
end IntegerVariables;
