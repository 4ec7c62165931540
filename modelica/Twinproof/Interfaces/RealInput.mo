within Twinproof.Interfaces;
connector RealInput = input Real "Signal that comes in"
  annotation(Documentation(info = "<html>
  <p>As <code>Modelica.Blocks.Interfaces.RealInput</code>.</p>
  <h4>Reference</h4>
  <ul>
  <li>Modelica Association, <em>Modelica Standard Library</em>, version 4</li>
  </ul>
  </html>"));
