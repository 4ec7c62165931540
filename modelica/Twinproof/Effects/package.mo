within Twinproof;
package Effects "What a model may lack; absent while its main parameter is 0"
  annotation(Documentation(info = "<html>
  <p>Conventions: with all parameters at their defaults an effect does exactly nothing. Parameters
  with another default than 0 shape the law. A passive effect opposes motion with positive
  parameters. To add an effect of your own, extend
  <a href=\"modelica://Twinproof.Interfaces.RotationalEffect\">RotationalEffect</a>,
  <a href=\"modelica://Twinproof.Interfaces.TranslationalEffect\">TranslationalEffect</a> or
  <a href=\"modelica://Twinproof.Interfaces.SignalEffect\">SignalEffect</a> and keep to them.</p>
  </html>"));
end Effects;
