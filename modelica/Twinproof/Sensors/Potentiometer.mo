within Twinproof.Sensors;
block Potentiometer "Endless potentiometer: counts that wrap, with a blind zone before the wrap"
  parameter Real N(unit = "1", min = 1, nominal = 1000) = 1024 "Counts per turn"
    annotation(__twinproof(known = true));
  parameter Real low(unit = "1", nominal = 100) = -306 "Smallest reading, just behind the wrap"
    annotation(__twinproof(known = true));
  parameter Real high_up(unit = "1", nominal = 1000) = 717
    "Reading at which the wiper leaves the track while it turns up"
    annotation(__twinproof(known = true));
  parameter Real high_down(unit = "1", nominal = 1000) = 640
    "Reading at which the wiper is back on the track while it turns down"
    annotation(__twinproof(known = true));
  parameter Real T(unit = "s", min = 1e-5, nominal = 1e-3) = 1e-3
    "Time after which a turn of the motion is noticed" annotation(__twinproof(known = true));
  parameter Real x_start(unit = "rad") = 0 "Start of the angle that follows, to know the direction";
  Interfaces.RealInput phi(unit = "rad") "Angle";
  Interfaces.RealOutput counts(unit = "1") "Reading";
  Real x(unit = "rad", start = x_start, fixed = true) "Angle a moment ago";
  Real c(unit = "1") "Angle in counts, between low and low + N";
equation
  T * der(x) = phi - x;
  c = phi * N / (2 * 3.14159265358979)
    - N * noEvent(floor((phi * N / (2 * 3.14159265358979) - low) / N));
  counts = noEvent(floor(0.5 + (if phi >= x then min(c, high_up)
    elseif c > high_down then low else c)));

  annotation(Documentation(info = "<html>
  <p>While the wiper is off its track the last reading is held: <code>high_up</code> on the way up
  until the wrap, <code>low</code> on the way down until the track begins again. Where it begins
  again depends on the direction: the defaults are setup 1 of the reference, whose blind zone has 1
  degree upwards and 27 degrees downwards. Setup 2 has 1091 counts per turn, <code>low</code> -322
  and 701 for both ends.</p>
  <p>A motion that turns round inside the zone is read as if it had come in the other way.</p>
  <h4>Reference</h4>
  <ul>
  <li>M. B. Arnolds, <em>Identification and control of the Rotary Inverted Pendulum</em>, report
  DCT 2003.100, Technische Universiteit Eindhoven (2003), section 3.1 and tables A.1 to A.5</li>
  </ul>
  </html>"));
end Potentiometer;
