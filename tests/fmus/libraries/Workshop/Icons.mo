within Workshop;
package Icons "Pictures"
  partial package Package "Icon for a package"
    annotation (Icon(graphics={Rectangle(extent={{-100,-100},{100,100}}, radius=25.0)}));
  end Package;

  partial model Example "Icon for an example"
    annotation (Icon(graphics={Ellipse(extent={{-100,-100},{100,100}})}));
  end Example;

  partial function Function "Icon for a function"
    annotation (Icon(graphics={Text(extent={{-150,105},{150,145}}, textString="%name")}));
  end Function;
end Icons;
