within;
package Workshop "A library written the way the Modelica Standard Library is"
  extends Workshop.Icons.Package;
  import Workshop.Units.SI;

  annotation (version="1.0.0", Documentation(info="<html>
<p>model Trap end Trap; is text, not a class.</p>
</html>"));
end Workshop;
