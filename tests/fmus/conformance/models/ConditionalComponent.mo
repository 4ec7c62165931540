model ConditionalComponent "conditional components"
  model Damper
    parameter Real d = 1;
    Real v;
    Real f;
  equation
    f = d * v;
  end Damper;
  parameter Boolean damped = true;
  parameter Boolean driven = false;
  Damper damper(d = 2) if damped;
  Damper unused if driven;
  Real v(start = 1, fixed = true);
  Real f;
equation
  if damped then
    damper.v = v;
    f = damper.f;
  else
    f = 0;
  end if;
  der(v) = -f;
end ConditionalComponent;
