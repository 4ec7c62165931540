model NoEvent "noEvent"
  Real x(start = 1, fixed = true);
equation
  der(x) = -noEvent(if x > 0 then sqrt(x) else 0);
end NoEvent;
