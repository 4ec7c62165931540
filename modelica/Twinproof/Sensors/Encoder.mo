within Twinproof.Sensors;
block Encoder "Incremental encoder: an angle in whole counts"
  parameter Real N(unit = "1", min = 1, nominal = 1000) = 6541 "Counts per turn, all edges"
    annotation(__twinproof(known = true));
  parameter Real phi_0(unit = "rad") = 0 "Angle at which the counter was zero";
  Interfaces.RealInput phi(unit = "rad") "Angle";
  Interfaces.RealOutput counts(unit = "1") "Reading of the counter";
  Interfaces.RealOutput angle(unit = "rad") "The reading as an angle";
equation
  counts = noEvent(floor((phi - phi_0) * N / (2 * 3.14159265358979) + 0.5));
  angle = counts * 2 * 3.14159265358979 / N;

  annotation(Documentation(info = "<html>
  <p>The error is at most half a count. Counters that overflow are not modelled: an angle of many
  turns is read as it is. The default is setup 1 of the reference, 18.17 counts per degree.</p>
  <h4>Reference</h4>
  <ul>
  <li>M. B. Arnolds, <em>Identification and control of the Rotary Inverted Pendulum</em>, report
  DCT 2003.100, Technische Universiteit Eindhoven (2003), section 3.2</li>
  </ul>
  </html>"));
end Encoder;
