"""Models and libraries as users write them."""

DISC = """model Disc "Inertia with a shaft end of its own"
  parameter Real J(unit = "kg.m2", min = 1e-6) = 0.2 "Inertia";
  parameter Real phi_start(unit = "rad") = 0.5 "Angle at the start";
  Twinproof.Interfaces.RotationalFlange shaft;
  Twinproof.Interfaces.RealInput u(unit = "N.m");
  Twinproof.Interfaces.RealOutput phi(unit = "rad", start = phi_start, fixed = true);
  Twinproof.Interfaces.RealOutput w(unit = "rad/s", start = 0, fixed = true);
equation
  phi = shaft.phi;
  w = der(phi);
  J * der(w) = u + shaft.tau;
end Disc;
"""

BENCH = """model Inertia "One-sided inertia"
  Twinproof.Interfaces.RotationalFlange flange_b;
  parameter Real J(unit = "kg.m2", min = 1e-6) = 0.1 "Inertia";
  Real w(unit = "rad/s", start = 0, fixed = true);
  Real phi(unit = "rad", start = 0.5, fixed = true);
equation
  phi = flange_b.phi;
  w = der(phi);
  J * der(w) = flange_b.tau;
end Inertia;

model Motor "Torque on a shaft"
  Twinproof.Interfaces.RotationalFlange flange_a;
  input Real i;
  parameter Real k(unit = "N.m/A") = 0.5 "Torque constant";
equation
  flange_a.tau = -k * i;
end Motor;

model Bench "Motor and load, composed"
  Motor motor;
  Inertia load(J = 0.25);
  Twinproof.Interfaces.RealInput i(unit = "A");
  Twinproof.Interfaces.RealOutput angle(unit = "rad");
equation
  motor.i = i;
  angle = load.phi;
  connect(motor.flange_a, load.flange_b);
end Bench;
"""

NAMESAKE = """model Car "Has a component of the name that our wrappers use"
  Twinproof.Plants.Pendulum plant(J = 0.2);
  Twinproof.Interfaces.RealInput tau(unit = "N.m");
  Twinproof.Interfaces.RealOutput theta(unit = "rad");
equation
  plant.tau = tau;
  theta = plant.theta;
end Car;
"""

OWN_EFFECT = """model Ratchet "Friction in one direction only"
  extends Twinproof.Interfaces.RotationalEffect;
  parameter Real tau_r(unit = "N.m", min = 0, nominal = 0.1) = 0 "Torque against positive motion";
equation
  flange.tau = tau_r * (1 + tanh(w / 0.05)) / 2;
end Ratchet;

"""


def library(folder):
    """A package of a user's own, in files; returns the Modelica path."""
    root = folder / "libraries"
    package = root / "Shop"
    package.mkdir(parents=True)
    (package / "package.mo").write_text(
        """within ;
package Shop "Effects of our shop"
  partial model Tooth "Not to be used by itself"
    extends Twinproof.Interfaces.RotationalEffect;
    parameter Real a(unit = "N.m", nominal = 0.1) = 0 "Amplitude";
  end Tooth;
  // model Ghost extends Twinproof.Interfaces.RotationalEffect; end Ghost;
  model Cogging "Cogging of twelve teeth; no model Phantom extends SignalEffect here"
    extends Tooth;
  equation
    flange.tau = a * sin(12 * phi);
  end Cogging;
  block Square "Quadratic distortion"
    extends Twinproof.Interfaces.SignalEffect;
    parameter Real q = 0 "Curvature, in the inverse unit of the signal";
  equation
    y = u + q * u * u;
  end Square;
end Shop;
"""
    )
    (package / "Rubber.mo").write_text(
        """within Shop;
model Rubber "Spring with a soft middle"
  extends Twinproof.Interfaces.TranslationalEffect;
  parameter Real c(unit = "N/m5", nominal = 10) = 0 "Stiffness";
equation
  flange.f = c * s ^ 5;
end Rubber;
"""
    )
    return root
