model Functions "function with local variables"
  function f
    input Real a;
    output Real b;
  protected
    Real c;
  algorithm
    c := a * a;
    b := c + 1;
  end f;
  Real x(start = 1, fixed = true);
equation
  der(x) = -f(x);
end Functions;
