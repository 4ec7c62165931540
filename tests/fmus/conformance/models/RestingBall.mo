model RestingBall "a ball that comes to rest (guarded accumulation of events)"
  Real h(start = 1, fixed = true);
  Real v(start = 0, fixed = true);
  discrete Integer n(start = 0, fixed = true);
  Boolean flying(start = true, fixed = true);
equation
  der(h) = v;
  der(v) = if flying then -9.81 else 0;
  when h < 0 and pre(flying) then
    n = pre(n) + 1;
    flying = pre(n) < 99;
    reinit(v, if pre(n) < 99 then -0.97 * pre(v) else 0);
  end when;
end RestingBall;
