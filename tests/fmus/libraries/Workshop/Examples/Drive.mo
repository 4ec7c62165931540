within Workshop.Examples;
model Drive "Two inertias, elastic shaft and gear, driven by a sine"
  extends Icons.Example;
  import SI = Workshop.Units.SI;
  parameter SI.Torque amplitude=10 "Amplitude of the driving torque";
  Components.Fixed fixed;
  Components.Torque torque;
  Components.Inertia inertia1(J=1, w(start=2, fixed=true), phi(fixed=true));
  Components.IdealGear idealGear(ratio=10);
  Components.Inertia inertia2(J=2);
  Components.SpringDamper spring(c=1.e4, d=40);
  Components.Inertia inertia3(J=2, w(fixed=true), phi(fixed=true, start=0.01));
  replaceable Components.Bearing bearing(useSupport=true, law(d=10));
  Blocks.Sine sine(amplitude=amplitude, f=5);
equation
  connect(inertia1.flange_b, idealGear.flange_a);
  connect(idealGear.flange_b, inertia2.flange_a);
  connect(inertia2.flange_b, spring.flange_a);
  connect(spring.flange_b, inertia3.flange_a);
  connect(bearing.flange_a, inertia2.flange_b);
  connect(torque.flange, inertia1.flange_a);
  connect(sine.y, torque.tau);
  connect(fixed.flange, bearing.support);
  annotation (experiment(StopTime=1.0, Interval=0.001));
end Drive;
