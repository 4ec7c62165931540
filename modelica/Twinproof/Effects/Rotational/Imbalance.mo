within Twinproof.Effects.Rotational;
model Imbalance "Weight off the axis of a wheel or rotor"
  extends Twinproof.Interfaces.RotationalEffect;

  parameter Real tau_s(unit = "N.m", nominal = 0.05) = 0
    "Torque towards phi = 0 while the axis is turned by a quarter";
  parameter Real tau_k(unit = "N.m", nominal = 0.05) = 0 "Torque towards negative phi at phi = 0";
equation
  flange.tau = tau_s * sin(phi) + tau_k * cos(phi);

  annotation(Documentation(info = "<html>
  <p>Torque of a mass off the axis, whatever its direction: its size is the root of the sum of
  both squares. Of a link that swings as a pendulum the first part is what the plant has
  already.</p>
  <h4>Reference</h4>
  <ul>
  <li>ISO 21940-1, <em>Mechanical vibration - Rotor balancing</em> (2019)</li>
  </ul>
  </html>"));
end Imbalance;
