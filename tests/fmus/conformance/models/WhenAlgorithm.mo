model WhenAlgorithm "when in an algorithm section"
  Real x(start = 0, fixed = true);
  Integer n(start = 0, fixed = true);
  discrete Real m(start = 0, fixed = true);
algorithm
  when x > 0.33 then
    n := n + 1;
    m := 2 * n;
  end when;
equation
  der(x) = 1;
end WhenAlgorithm;
