within Twinproof.Plants;
model RoadCar "Car steered at walking pace and above: kinematic bicycle without side slip"
  parameter Real L(unit = "m", min = 0.5, nominal = 3) = 2.65 "Wheelbase"
    annotation(__twinproof(known = true));
  parameter Real ratio(unit = "1", min = 1, max = 50, nominal = 15) = 13
    "Angle of the steering wheel over that of the road wheels";
  Interfaces.RealInput v(unit = "m/s") "Speed of the rear axle, negative in reverse";
  Interfaces.RealInput delta(unit = "rad") "Angle of the steering wheel, positive to the left";
  Interfaces.RealOutput yaw_rate(unit = "rad/s") "Yaw rate, positive to the left";
equation
  yaw_rate = v / L * tan(delta / ratio);

  annotation(Documentation(info = "<html>
  <p>Both axles roll without slipping sideways, so the car follows its road wheels at once and the
  model has no state. At small angles the yaw rate is <code>v*delta/(L*ratio)</code>: recordings
  give the product only, hence the wheelbase, which anybody can measure, is known.</p>
  <p>Nothing turns or slides here that a torque could act on; effects stand in series with the
  inputs and with the output. Side slip makes a car turn less the faster it is, as if it drove more
  slowly: <a href=\"modelica://Twinproof.Effects.Signal.Understeer\">Understeer</a> at
  <code>v</code>. A lag or a delay of the yaw rate goes to <code>delta</code> or
  <code>yaw_rate</code>, an error of the zero of the steering angle is an
  <a href=\"modelica://Twinproof.Effects.Signal.Offset\">Offset</a> at <code>delta</code>.</p>
  <h4>Reference</h4>
  <ul>
  <li>R. Rajamani, <em>Vehicle Dynamics and Control</em>, 2nd ed. (2012), section 2.2</li>
  </ul>
  </html>"));
end RoadCar;
