within Twinproof.Effects;
package Rotational "Torques on one flange"
  annotation(Documentation(info = "<html>
  <p>To be connected to the flange of a point at which something turns.</p>
  </html>"));
end Rotational;
