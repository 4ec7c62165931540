model RigidShaft "index 3: two inertias, rigidly connected by a gear"
  connector Flange
    Real phi;
    flow Real tau;
  end Flange;
  model Inertia
    parameter Real J = 1;
    Flange a;
    Flange b;
    Real phi;
    Real w;
  equation
    a.phi = phi;
    b.phi = phi;
    der(phi) = w;
    J * der(w) = a.tau + b.tau;
  end Inertia;
  model Gear
    parameter Real ratio = 2;
    Flange a;
    Flange b;
  equation
    a.phi = ratio * b.phi;
    ratio * a.tau + b.tau = 0;
  end Gear;
  model Drive
    Flange a;
  equation
    a.tau = -sin(4 * time);
  end Drive;
  model Brake
    Flange a;
  equation
    a.tau = 0.2 * der(a.phi);
  end Brake;
  Drive drive;
  Brake brake;
  Inertia motor(J = 0.5, phi(start = 0, fixed = true), w(start = 1, fixed = true));
  Gear gear;
  Inertia load(J = 3);
equation
  connect(motor.b, gear.a);
  connect(gear.b, load.a);
  connect(drive.a, motor.a);
  connect(load.b, brake.a);
end RigidShaft;
