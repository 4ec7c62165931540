model Delays "delay"
  Real x(start = 0, fixed = true);
  Real y;
equation
  der(x) = cos(3 * time);
  y = delay(sin(2 * time), 0.21);
end Delays;
