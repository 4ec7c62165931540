within Twinproof.Effects;
package Translational "Forces on one flange"
  annotation(Documentation(info = "<html>
  <p>To be connected to the flange of a point at which something slides.</p>
  </html>"));
end Translational;
