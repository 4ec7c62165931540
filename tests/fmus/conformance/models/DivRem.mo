model DivRem "div and rem"
  Real y[4];
equation
  y = {div(time + 0.01, 0.3), rem(time + 0.01, 0.3), div(-time - 0.01, 0.3), rem(-time - 0.01, 0.3)};
end DivRem;
