model Import "packages and import"
  import C = Numbers;
  Real x(start = 1, fixed = true);
equation
  der(x) = C.negative(C.rate * x);
end Import;

package Numbers
  constant Real rate = 2.5;
  function negative
    input Real u;
    output Real y;
  algorithm
    y := -u;
  end negative;
end Numbers;
