model InputsOutputs "top-level inputs and outputs, direct feed-through"
  input Real u(start = 0.7);
  output Real y;
  output Real x(start = 0, fixed = true);
equation
  der(x) = u - x;
  y = 2 * u + x;
end InputsOutputs;
