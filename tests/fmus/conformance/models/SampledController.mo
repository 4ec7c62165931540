model SampledController "a sampled PI controller of a continuous plant"
  parameter Real Ts = 0.1;
  Real y(start = 0, fixed = true);
  discrete Real u(start = 0, fixed = true);
  discrete Real integral(start = 0, fixed = true);
equation
  der(y) = -2 * y + u;
  when sample(0, Ts) then
    integral = pre(integral) + Ts * (1 - y);
    u = 3 * (1 - y) + 4 * integral;
  end when;
end SampledController;
