within Workshop.Examples;
model Servo "A controlled axis, with dry friction in place of viscous"
  extends Icons.Example;
  parameter Blocks.Types.SimpleController controllerType=Blocks.Types.SimpleController.PI;
  input Real w_ref(unit="rad/s") "Speed asked for";
  output Units.SI.AngularVelocity w(start=0, fixed=true) "Speed of the axis";
  output Units.SI.Torque tau = torque.tau;
  Blocks.Controller controller(k=2, Ti=0.3, controllerType=controllerType);
  Components.Torque torque;
  Components.Inertia axis(J=0.5, phi(start=0, fixed=true));
  DryBearing bearing;
protected
  model DryBearing = Components.Bearing(redeclare model Law = Components.Bearing.Dry);
equation
  w = axis.w;
  controller.u = w_ref - w;
  connect(controller.y, torque.tau);
  connect(torque.flange, axis.flange_a);
  connect(axis.flange_b, bearing.flange_a);
end Servo;
