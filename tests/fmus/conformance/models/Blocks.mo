model Blocks "blocks, connected in series"
  block Integrator
    input Real u;
    output Real y(start = 0, fixed = true);
  equation
    der(y) = u;
  end Integrator;
  block Gain
    parameter Real k = 1;
    input Real u;
    output Real y;
  equation
    y = k * u;
  end Gain;
  Gain gain(k = -4);
  Integrator velocity(y(start = 1));
  Integrator position;
equation
  gain.u = position.y;
  velocity.u = gain.y;
  position.u = velocity.y;
end Blocks;
