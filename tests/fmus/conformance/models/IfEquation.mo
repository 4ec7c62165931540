model IfEquation "if-equation with several equations a branch"
  Real x(start = 0, fixed = true);
  Real a;
  Real b;
equation
  if time < 0.43 then
    a = 1;
    b = 2;
  elseif time < 0.77 then
    a = -3;
    b = a;
  else
    a = 0;
    b = 5;
  end if;
  der(x) = a + b;
end IfEquation;
