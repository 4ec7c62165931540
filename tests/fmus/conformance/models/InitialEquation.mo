model InitialEquation "initial equation: steady start"
  Real x;
  Real y;
initial equation
  der(x) = 0;
  der(y) = 1;
equation
  der(x) = -x + y * cos(time);
  der(y) = -2 * y + 3;
end InitialEquation;
