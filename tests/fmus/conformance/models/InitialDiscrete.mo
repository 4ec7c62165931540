model InitialDiscrete "initial equation of a discrete variable"
  parameter Real p = 3;
  discrete Real d;
  Real x(start = 1, fixed = true);
initial equation
  d = p / 2;
equation
  der(x) = -d;
  when x < 0.4 then
    d = 0.5;
  end when;
end InitialDiscrete;
