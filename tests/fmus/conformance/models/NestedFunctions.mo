model NestedFunctions "function that calls a function, default and named arguments"
  function scaled
    input Real u;
    input Real k = 2;
    output Real y;
  algorithm
    y := k * u;
  end scaled;
  function twice
    input Real u;
    output Real y;
  algorithm
    y := scaled(u) + scaled(u, k = 3);
  end twice;
  Real x(start = 1, fixed = true);
equation
  der(x) = -twice(x);
end NestedFunctions;
