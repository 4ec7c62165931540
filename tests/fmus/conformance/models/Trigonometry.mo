model Trigonometry "sin, cos, tan, asin, acos, atan, atan2"
  Real y[7];
equation
  y = {sin(time), cos(time), tan(time / 2), asin(time / 2), acos(time / 2), atan(time), atan2(time, 0.3 - time)};
end Trigonometry;
