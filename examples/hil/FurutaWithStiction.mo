within;
model FurutaWithStiction "Furuta pendulum of the report: its arm sticks, its rod is read by a potentiometer"
  extends Twinproof.Plants.FurutaPendulum;
  Twinproof.Effects.Rotational.StribeckFriction stiction(tau_s = 0.222, w_s = 0.1, w_0 = 0.01)
    "With the Coulomb friction of the plant a breakaway torque of 0.218 N.m, which is 45 counts";
  Twinproof.Sensors.Potentiometer potentiometer(x_start = beta_start)
    "Of setup 1: its blind zone begins 45 degrees behind upright, and depends on the direction";
  Twinproof.Interfaces.RealOutput beta_read(unit = "rad") "Angle of the rod as the potentiometer reads it";
equation
  connect(stiction.flange, arm.flange);
  potentiometer.phi = beta;
  beta_read = potentiometer.counts * 2 * 3.14159265358979 / potentiometer.N;
end FurutaWithStiction;
