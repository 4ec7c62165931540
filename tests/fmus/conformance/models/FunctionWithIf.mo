model FunctionWithIf "function with if and several outputs"
  function limited
    input Real u;
    output Real y;
    output Real excess;
  algorithm
    if u > 0.5 then
      y := 0.5;
    else
      y := u;
    end if;
    excess := u - y;
  end limited;
  Real y;
  Real e;
equation
  (y, e) = limited(time);
end FunctionWithIf;
