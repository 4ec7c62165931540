model TimeEvents "time events"
  parameter Real t0 = 0.37;
  Real x(start = 0, fixed = true);
equation
  der(x) = if time >= t0 and time < 2 * t0 then 1 else 0;
end TimeEvents;
