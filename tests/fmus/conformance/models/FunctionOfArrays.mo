model FunctionOfArrays "function with arrays and a for-loop"
  function weighted
    input Real v[3];
    input Real w[3];
    output Real s;
  algorithm
    s := 0;
    for i in 1:3 loop
      s := s + v[i] * w[i];
    end for;
  end weighted;
  Real x[3](start = {1, 2, 3}, each fixed = true);
  Real y;
equation
  der(x) = -x;
  y = weighted(x, {1, 10, 100});
end FunctionOfArrays;
