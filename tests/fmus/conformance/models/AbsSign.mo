model AbsSign "abs and sign"
  Real x(start = 0, fixed = true);
  Real y(start = 0, fixed = true);
equation
  der(x) = abs(time - 0.5);
  der(y) = sign(time - 0.47);
end AbsSign;
