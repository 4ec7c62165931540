model ComponentArray "array of components, connected in a loop"
  connector Flange
    Real s;
    flow Real f;
  end Flange;
  model Mass
    Flange a;
    Flange b;
    Real s(start = 0, fixed = true);
    Real v(start = 0, fixed = true);
  equation
    a.s = s;
    b.s = s;
    der(s) = v;
    der(v) = a.f + b.f;
  end Mass;
  model Spring
    Flange a;
    Flange b;
  equation
    a.f = 4 * (a.s - b.s);
    a.f + b.f = 0;
  end Spring;
  Mass mass[3](s(start = {1, 0, 0}));
  Spring spring[2];
equation
  for i in 1:2 loop
    connect(mass[i].b, spring[i].a);
    connect(spring[i].b, mass[i + 1].a);
  end for;
end ComponentArray;
