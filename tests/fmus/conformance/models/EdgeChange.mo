model EdgeChange "edge, change and pre of Boolean variables"
  Boolean b;
  Integer rises(start = 0, fixed = true);
  Integer changes(start = 0, fixed = true);
equation
  b = sin(10 * time + 0.2) > 0;
  when edge(b) then
    rises = pre(rises) + 1;
  end when;
  when change(b) then
    changes = pre(changes) + 1;
  end when;
end EdgeChange;
