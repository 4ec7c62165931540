within Twinproof.Effects.Signal;
block Eccentricity "Error of an angle that repeats with every turn"
  extends Twinproof.Interfaces.SignalEffect(u(unit = "rad"), y(unit = "rad"));

  parameter Real e_s(unit = "rad", min = -0.5, max = 0.5, nominal = 0.01) = 0
    "Sine part of the error";
  parameter Real e_k(unit = "rad", min = -0.5, max = 0.5, nominal = 0.01) = 0
    "Cosine part of the error";
equation
  y = u + e_s * sin(u) + e_k * cos(u);

  annotation(Documentation(info = "<html>
  <p>The disc of an encoder, or the magnet before its chip, sits off the axis by a small share of
  its radius. Over a small part of a turn it is an error of scale and zero and cannot be told from
  these.</p>
  <h4>Reference</h4>
  <ul>
  <li>E. O. Doebelin, <em>Measurement Systems: Application and Design</em>, 5th ed. (2004)</li>
  </ul>
  </html>"));
end Eccentricity;
