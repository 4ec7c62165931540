within Twinproof.Effects.Rotational;
model EndStop "Elastic stops on both sides of a free range"
  extends Twinproof.Interfaces.RotationalEffect;

  parameter Real k_e(unit = "N.m/rad", min = 0, nominal = 10) = 0 "Stiffness of the stops";
  parameter Real phi_e(unit = "rad", min = 0.05, max = 10, nominal = 0.5) = 0.3
    "Angle at which a stop is touched, on either side of phi = 0";
equation
  flange.tau = k_e * (phi - max(-phi_e, min(phi_e, phi)));

  annotation(Documentation(info = "<html>
  <p>No torque inside the range, a stiffness <code>k_e</code> outside of it: a bumper, a tether, a
  hose at the end of its slack. A recording that never touches a stop says nothing about it.</p>
  <h4>Reference</h4>
  <ul>
  <li>S. W. Shaw, P. J. Holmes, <em>A periodically forced piecewise linear oscillator</em>,
  Journal of Sound and Vibration 90 (1983) 129-155</li>
  </ul>
  </html>"));
end EndStop;
