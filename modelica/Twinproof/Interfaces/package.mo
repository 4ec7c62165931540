within Twinproof;
package Interfaces "Connectors, the points of a plant, and what all effects of a kind share"
  annotation(Documentation(info = "<html>
  <p>The connectors have the shape of those of the Modelica Standard Library, so that components
  of both can be connected.</p>
  </html>"));
end Interfaces;
