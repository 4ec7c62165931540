within Twinproof.Effects.Signal;
block Backlash "Play: the output waits until the input has crossed a gap"
  extends Twinproof.Interfaces.SignalEffect;

  parameter Real w(min = 0, nominal = 0.02) = 0 "Half the gap, in the unit of the signal";
  parameter Real w_min(min = 1e-9, nominal = 1e-3) = 1e-3
    "Smallest half gap represented exactly, in the unit of the signal"
    annotation(__twinproof(known = true));
  parameter Real T(unit = "s", min = 1e-4, nominal = 2e-3) = 2e-3
    "Time in which the flanks meet" annotation(__twinproof(known = true));
  parameter Real x_start = 0 "Start of the driven side, in the unit of the signal";
  Real x(start = x_start, fixed = true) "Driven side, in the unit of the signal";
protected
  final parameter Real w_r = max(w, w_min) "Half gap of the memory, in the unit of the signal";
  Real e(unit = "1") "Position in the gap, from -1 to 1";
equation
  e = max(-1.0, min(1.0, (u - x) / w_r));
  T * der(x) = u - x - w_r * e;
  y = u - w * e;

  annotation(__twinproof(search = false), Documentation(info = "<html>
  <p>Gears, linkages, the hysteresis of a sensor. While the flanks touch the output is exactly
  <code>w</code> behind; in between it rests. A turn of the input is noticed after about
  <code>T</code>.</p>
  <p>Below <code>w_min</code> the block is a gap of <code>w_min</code> whose effect is scaled by
  <code>w/w_min</code>. So it is exactly absent at <code>w = 0</code>, nothing is divided by zero,
  and a small <code>w</code> has the right first-order effect <code>-w*sign(der(u))</code>. Set
  <code>w_min</code> to the resolution of the signal.</p>
  <p>Quantities are in the unit of the signal that the block stands in.</p>
  <h4>Reference</h4>
  <ul>
  <li>G. Tao, P. V. Kokotovi&#263;, <em>Adaptive Control of Systems with Actuator and Sensor
  Nonlinearities</em> (1996)</li>
  <li>M. Nordin, P.-O. Gutman, <em>Controlling mechanical systems with backlash - a survey</em>,
  Automatica 38 (2002) 1633-1649</li>
  </ul>
  </html>"));
end Backlash;
