block SignLossInReverse "Speed that is counted without its sign, driven backwards too"
  extends Twinproof.Interfaces.SignalEffect(u(unit = "m/s"), y(unit = "m/s"));

  Twinproof.Interfaces.RealInput reverse(unit = "1") "1 in reverse gear, else 0";
  parameter Real k(unit = "1", min = 0, max = 1, nominal = 1) = 0
    "1 where the sign is lost, 0 where not";
equation
  y = u * (1 - 2 * reverse * (if k > 0.02 then 1.0 else k));

  annotation(Documentation(info = "<html>
  <p>Wheel speeds come from pulses, whose frequency has no sign. Stands between the speed that
  was recorded and the one that the car drove.</p>
  </html>"));
end SignLossInReverse;

model RoadCarWithGear "Kinematic bicycle; its record also knows the gear"
  extends Twinproof.Plants.RoadCar;
  Twinproof.Interfaces.RealInput reverse(unit = "1") "1 in reverse gear, else 0";
end RoadCarWithGear;
