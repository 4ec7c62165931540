within Twinproof.Interfaces;
connector RealOutput = output Real "Signal that goes out"
  annotation(Documentation(info = "<html>
  <p>As <code>Modelica.Blocks.Interfaces.RealOutput</code>.</p>
  <h4>Reference</h4>
  <ul>
  <li>Modelica Association, <em>Modelica Standard Library</em>, version 4</li>
  </ul>
  </html>"));
