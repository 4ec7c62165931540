model InitialFlag "initial() in expressions"
  Real x;
  Real rate;
  Boolean high(start = false, fixed = true);
initial equation
  x = rate;
equation
  rate = if initial() then 5 else 2;
  der(x) = -rate * x;
  high = initial() and x > 4 or pre(high);
end InitialFlag;
