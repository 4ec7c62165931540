model RedeclaredComponent "replaceable and redeclare of a component, with a modifier"
  extends Plant(redeclare Cubic law(k = 4));
end RedeclaredComponent;

partial model Law
  input Real u;
  output Real y;
  parameter Real k = 1;
end Law;

model Linear
  extends Law;
equation
  y = k * u;
end Linear;

model Cubic
  extends Law;
equation
  y = k * u ^ 3;
end Cubic;

model Plant
  replaceable Linear law constrainedby Law;
  Real x(start = 1, fixed = true);
equation
  law.u = x;
  der(x) = -law.y;
end Plant;
