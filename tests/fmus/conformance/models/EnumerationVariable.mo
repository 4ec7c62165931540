model EnumerationVariable "variable of an enumeration type"
  type Mode = enumeration(up, down);
  Mode mode(start = Mode.up, fixed = true);
  Real x(start = 0, fixed = true);
equation
  der(x) = if mode == Mode.up then 1 else -1;
  when x > 0.57 then
    mode = Mode.down;
  end when;
end EnumerationVariable;
