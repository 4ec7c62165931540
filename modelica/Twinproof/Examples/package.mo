within Twinproof;
package Examples "A plant with an effect, in the two forms there are"
  annotation(Documentation(info = "<html>
  <p>What a person would type, and what the tool writes.</p>
  </html>"));
end Examples;
