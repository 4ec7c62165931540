within Workshop;
package Interfaces "Connectors and partial models"
  extends Icons.Package;

  connector Flange_a "Flange on the left"
    Units.SI.Angle phi "Absolute rotation angle of flange";
    flow Units.SI.Torque tau "Cut torque in the flange";
    annotation (defaultComponentName="flange_a");
  end Flange_a;

  connector Flange_b "Flange on the right"
    Units.SI.Angle phi "Absolute rotation angle of flange";
    flow Units.SI.Torque tau "Cut torque in the flange";
  end Flange_b;

  connector RealInput = input Real "'input Real' as connector";
  connector RealOutput = output Real "'output Real' as connector";

  partial block SO "Single output"
    RealOutput y "Connector of Real output signal";
  end SO;

  partial block SISO "Single input, single output"
    extends SO;
    RealInput u "Connector of Real input signal";
  end SISO;
end Interfaces;
