within Twinproof.Examples;
model WheeledPendulumWithDeadZone "Wheeled pendulum whose amplifier ignores small voltages"
  Twinproof.Plants.WheeledPendulum plant "The plant as it was";
  Twinproof.Effects.Signal.DeadZone deadZone(w = 0.2) "0.2 V that do nothing";
  Twinproof.Interfaces.RealInput V(unit = "V") "Motor voltage";
  Twinproof.Interfaces.RealOutput theta_w(unit = "rad") "Wheel angle, against the vertical";
  Twinproof.Interfaces.RealOutput theta_p(unit = "rad") "Pitch of the body, zero upright";
  Twinproof.Interfaces.RealOutput omega_w(unit = "rad/s") "Wheel speed";
  Twinproof.Interfaces.RealOutput omega_p(unit = "rad/s") "Pitch rate";
equation
  connect(V, deadZone.u);
  connect(deadZone.y, plant.V);
  connect(plant.theta_w, theta_w);
  connect(plant.theta_p, theta_p);
  connect(plant.omega_w, omega_w);
  connect(plant.omega_p, omega_p);

  annotation(Documentation(info = "<html>
  <p>An effect on a signal: a model that contains the plant, with the block in series.</p>
  <h4>Reference</h4>
  <ul>
  <li>C.-C. Peng, N.-J. Cheng, M.-C. Tsai, <em>Application of an Output Filtering Method for an
  Unstable Wheel-Driven Pendulum System Parameter Identification</em>, Electronics 12 (2023)
  4569</li>
  </ul>
  </html>"));
end WheeledPendulumWithDeadZone;
