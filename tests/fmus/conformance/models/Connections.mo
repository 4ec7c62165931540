model Connections "connect, with flow and potential variables"
  connector Pin
    Real v;
    flow Real i;
  end Pin;
  model Ground
    Pin p;
  equation
    p.v = 0;
  end Ground;
  partial model TwoPin
    Pin p;
    Pin n;
    Real v;
    Real i;
  equation
    v = p.v - n.v;
    i = p.i;
    p.i + n.i = 0;
  end TwoPin;
  model Resistor
    extends TwoPin;
    parameter Real R = 1;
  equation
    v = R * i;
  end Resistor;
  model Capacitor
    extends TwoPin;
    parameter Real C = 1;
  equation
    C * der(v) = i;
  end Capacitor;
  model Source
    extends TwoPin;
    parameter Real V = 1;
  equation
    v = V;
  end Source;
  Source source(V = 5);
  Resistor resistor(R = 2);
  Resistor leak(R = 6);
  Capacitor capacitor(C = 0.1, v(start = 0, fixed = true));
  Ground ground;
equation
  connect(source.p, resistor.p);
  connect(resistor.n, capacitor.p);
  connect(resistor.n, leak.p);
  connect(leak.n, ground.p);
  connect(capacitor.n, ground.p);
  connect(source.n, ground.p);
end Connections;
