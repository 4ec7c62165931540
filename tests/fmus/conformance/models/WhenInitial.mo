model WhenInitial "when initial()"
  Real x(start = 1, fixed = true);
  discrete Real d(start = 0, fixed = true);
equation
  der(x) = -x;
  when {initial(), x < 0.5} then
    d = x;
  end when;
end WhenInitial;
