model Exponentials "sinh, cosh, tanh, exp, log, log10, sqrt, powers"
  Real y[8];
equation
  y = {sinh(time), cosh(time), tanh(time), exp(-time), log(1 + time), log10(1 + time), sqrt(time), (1 + time) ^ 2.5};
end Exponentials;
