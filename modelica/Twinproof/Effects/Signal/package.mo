within Twinproof.Effects;
package Signal "Blocks in series with an input or an output"
  annotation(Documentation(info = "<html>
  <p>To be put between an input and what it drives, or between a quantity and its sensor.</p>
  </html>"));
end Signal;
