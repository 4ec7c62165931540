within;
model FurutaWithStiction "Furuta pendulum of the report whose arm sticks up to 45 counts"
  extends Twinproof.Plants.FurutaPendulum;
  Twinproof.Effects.Rotational.StribeckFriction stiction(tau_s = 0.222, w_s = 0.1, w_0 = 0.01)
    "With the Coulomb friction of the plant a breakaway torque of 0.218 N.m, which is 45 counts";
equation
  connect(stiction.flange, arm.flange);
end FurutaWithStiction;
