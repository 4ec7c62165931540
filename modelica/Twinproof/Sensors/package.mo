within Twinproof;
package Sensors "What a signal becomes on its way to the computer"
  annotation(Documentation(info = "<html>
  <p>To be put behind the output of a plant, in a model that contains both. They are deterministic:
  noise is a parameter that tells how much there is, and is drawn by whoever simulates, from a seed
  of his own. Steps of counts make no events.</p>
  <p>Errors that a fit may find are <a href=\"modelica://Twinproof.Effects.Signal\">effects</a>.</p>
  </html>"));
end Sensors;
