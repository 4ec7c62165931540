within Twinproof.Interfaces;
partial block SignalEffect "An effect in series with an input or an output"
  RealInput u "Signal before the effect";
  RealOutput y "Signal after the effect, in the same unit";

  annotation(Documentation(info = "<html>
  <p>A class that extends this one gives <code>y</code>. Signals have no unit here: they take that
  of the place where the block stands.</p>
  <h4>Reference</h4>
  <ul>
  <li>Modelica Association, <em>Modelica Standard Library</em>, version 4</li>
  </ul>
  </html>"));
end SignalEffect;
