model RedeclaredClass "redeclare of a class in the body"
  extends Base;
  redeclare model Law = Fast;
end RedeclaredClass;

model Base
  replaceable model Law = Slow;
  Law law;
  Real x(start = 1, fixed = true);
equation
  der(x) = -law.k * x;
end Base;

model Slow
  parameter Real k = 1;
end Slow;

model Fast
  parameter Real k = 5;
end Fast;
