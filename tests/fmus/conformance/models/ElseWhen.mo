model ElseWhen "elsewhen"
  Real x(start = 0, fixed = true);
  Integer n(start = 0, fixed = true);
  Boolean b(start = false, fixed = true);
equation
  der(x) = 1;
  when x > 0.31 then
    n = 1;
    b = true;
  elsewhen x > 0.63 then
    n = pre(n) + 5;
    b = not pre(b);
  end when;
end ElseWhen;
