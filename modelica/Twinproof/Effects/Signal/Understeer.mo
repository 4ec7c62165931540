within Twinproof.Effects.Signal;
block Understeer "Side slip: a car turns less the faster it drives"
  extends Twinproof.Interfaces.SignalEffect(u(unit = "m/s"), y(unit = "m/s"));

  parameter Real K_us(unit = "s2/m2", min = 0, max = 0.1, nominal = 2e-3) = 0
    "One over the square of the characteristic speed";
equation
  y = u / (1 + K_us * u^2);

  annotation(Documentation(info = "<html>
  <p>Stands at the speed of a car without side slip and makes it the speed at which that car would
  turn as this one does: the yaw rate becomes <code>v*tan(delta/ratio)/(L*(1 + K_us*v^2))</code>,
  the steady turn of a linear two-axle model with <code>K_us = m*(l_r/C_f - l_f/C_r)/L^2</code>,
  from mass, distances of the axles and their cornering stiffness. Nothing of it needs the
  steering angle, which is why an effect on one signal suffices.</p>
  <h4>Reference</h4>
  <ul>
  <li>R. Rajamani, <em>Vehicle Dynamics and Control</em>, 2nd ed. (2012), section 3.3</li>
  <li>T. D. Gillespie, <em>Fundamentals of Vehicle Dynamics</em> (1992), chapter 6</li>
  </ul>
  </html>"));
end Understeer;
