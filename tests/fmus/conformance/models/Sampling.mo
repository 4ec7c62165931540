model Sampling "sample"
  Real x(start = 1, fixed = true);
  discrete Real u(start = 0, fixed = true);
equation
  der(x) = -u;
  when sample(0.1, 0.25) then
    u = x;
  end when;
end Sampling;
