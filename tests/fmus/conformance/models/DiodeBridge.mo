model DiodeBridge "nonlinear loop with events: diode and resistor in series"
  Real u;
  Real v(start = 0);
  Real i;
  Real q(start = 0, fixed = true);
equation
  u = sin(6 * time);
  i = 1e-3 * (if v < 0.5 then exp(10 * v) - 1 else exp(5) * (1 + 10 * (v - 0.5)) - 1);
  u = v + 2 * i;
  der(q) = i;
end DiodeBridge;
