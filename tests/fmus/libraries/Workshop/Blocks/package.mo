within Workshop;
package Blocks "Signals"
  extends Icons.Package;

  package Types "Choices"
    type SimpleController = enumeration(
        P "P controller",
        PI "PI controller",
        PID "PID controller") "Kind of controller";
    type Init = enumeration(NoInit "No initialization", InitialState, SteadyState);
  end Types;

  block Sine "Generate sine signal"
    import Workshop.Constants.pi;
    parameter Real amplitude=1 "Amplitude of sine wave";
    parameter Units.SI.Frequency f(start=1) "Frequency of sine wave";
    parameter Units.SI.Angle phase=0 "Phase of sine wave";
    parameter Real offset=0 "Offset of output signal y";
    parameter Units.SI.Time startTime=0 "Output y = offset for time < startTime";
    extends Interfaces.SO;
  equation
    y = offset + (if time < startTime then 0 else amplitude*Math.sin(2*pi*f*(time - startTime) + phase));
  end Sine;

  block Constant "Generate constant signal of type Real"
    parameter Real k(start=1) "Constant output value";
    extends Interfaces.SO;
  equation
    y = k;
  end Constant;

  block Add "Output the sum of the two inputs"
    extends Interfaces.SO;
    Interfaces.RealInput u1;
    Interfaces.RealInput u2;
    parameter Real k1=+1 "Gain of input signal 1";
    parameter Real k2=+1 "Gain of input signal 2";
  equation
    y = k1*u1 + k2*u2;
  end Add;

  block Gain "Output the product of a gain value with the input signal"
    parameter Real k(start=1) "Gain value multiplied with input signal";
    extends Interfaces.SISO;
  equation
    y = k*u;
  end Gain;

  block Integrator "Output the integral of the input signal"
    extends Interfaces.SISO;
    parameter Real k=1 "Integrator gain";
    parameter Types.Init initType=Types.Init.InitialState "Type of initialization"
      annotation (Evaluate=true);
    parameter Real y_start=0;
  initial equation
    if initType == Types.Init.SteadyState then
      der(y) = 0;
    elseif initType == Types.Init.InitialState then
      y = y_start;
    end if;
  equation
    der(y) = k*u;
  end Integrator;

  block Controller "P or PI controller"
    import Workshop.Blocks.Types.SimpleController;
    extends Interfaces.SISO;
    parameter SimpleController controllerType=SimpleController.PI "Type of controller";
    parameter Real k=1 "Gain of controller";
    parameter Units.SI.Time Ti(min=Constants.eps)=0.5 "Time constant of Integrator block"
      annotation (Dialog(enable=controllerType == SimpleController.PI));
    parameter Types.Init initType=Types.Init.InitialState;
    Gain P(k=1) "Proportional part";
    Integrator I(k=1/Ti, final initType=initType) if with_I "Integral part";
    Constant zero(k=0) if not with_I;
    Add add;
    Gain gain(k=k);
  protected
    parameter Boolean with_I=controllerType == SimpleController.PI annotation (Evaluate=true);
  equation
    connect(u, P.u);
    connect(u, I.u);
    connect(P.y, add.u1);
    connect(I.y, add.u2);
    connect(zero.y, add.u2);
    connect(add.y, gain.u);
    connect(gain.y, y);
  end Controller;
end Blocks;
