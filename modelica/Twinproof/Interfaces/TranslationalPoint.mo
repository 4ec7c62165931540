within Twinproof.Interfaces;
model TranslationalPoint "Place on a plant where forces can be attached"
  TranslationalFlange flange "Connect effects here";
  input Real s(unit = "m") "Position of this place, given by the plant";
  Real f(unit = "N") "Sum of the attached forces along s, for the equation of motion";
equation
  flange.s = s;
  flange.f = f;

  annotation(Documentation(info = "<html>
  <p>A plant declares a point, sets its <code>s</code> and adds its <code>f</code> to the
  equation of motion. With nothing attached <code>f</code> is zero. The flange sits inside a
  component, because a class that extends the plant can connect to it there; a flange declared in
  the plant itself would be a connector to the outside and could not be connected from within.</p>
  <h4>Reference</h4>
  <ul>
  <li>Modelica Association, <em>Modelica Standard Library</em>, version 4</li>
  </ul>
  </html>"));
end TranslationalPoint;
