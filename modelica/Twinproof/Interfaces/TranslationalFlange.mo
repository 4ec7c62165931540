within Twinproof.Interfaces;
connector TranslationalFlange "Rod end at which forces act"
  Real s(unit = "m") "Position";
  flow Real f(unit = "N") "Force into the component";

  annotation(Documentation(info = "<html>
  <p>Has the shape of the flanges of <code>Modelica.Mechanics.Translational</code> and can be
  connected to them.</p>
  <h4>Reference</h4>
  <ul>
  <li>Modelica Association, <em>Modelica Standard Library</em>, version 4</li>
  </ul>
  </html>"));
end TranslationalFlange;
