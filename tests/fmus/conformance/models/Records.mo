model Records "records"
  record Point
    Real a;
    Real b;
  end Point;
  Point p;
  Real x(start = 1, fixed = true);
equation
  p.a = x;
  p.b = 2 * p.a;
  der(x) = -p.a - p.b;
end Records;
