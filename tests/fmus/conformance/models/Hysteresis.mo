model Hysteresis "hysteresis: a Boolean with memory"
  Real T(start = 0.2, fixed = true);
  Boolean on(start = true, fixed = true);
equation
  der(T) = if on then 4 else -2;
  on = if pre(on) then T < 1 else T < 0.5;
end Hysteresis;
