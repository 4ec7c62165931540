within;
package Twinproof "Plants, and the physical effects that a model of them may lack"
  annotation(version = "0.1.0",
    Documentation(info = "<html>
  <p>A plant has <em>points</em>, where torques or forces act, inputs and outputs. An effect is
  added by extending the plant, declaring the effect and connecting it to a point; an effect on a
  signal is put in series with an input or an output, in a model that contains the plant. See
  <a href=\"modelica://Twinproof.Examples\">Examples</a>.</p>
  <p>The vendor annotation <code>__twinproof(known = true)</code> marks a parameter that is not to
  be fitted.</p>
  </html>"));
end Twinproof;
