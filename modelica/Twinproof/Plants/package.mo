within Twinproof;
package Plants "Machines, with the physics that everybody would write down first"
  annotation(Documentation(info = "<html>
  <p>Equations are equations of motion, not solved for the accelerations. Every state starts at
  the parameter <code>&lt;state&gt;_start</code>.</p>
  </html>"));
end Plants;
