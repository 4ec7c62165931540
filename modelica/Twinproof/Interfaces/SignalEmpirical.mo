within Twinproof.Interfaces;
partial block SignalEmpirical "A bend of a signal drawn from data, without a law behind it"
  extends SignalEffect;

  parameter Real c_1(nominal = 0.1) = 0 "Height of bump 1, in the unit of the signal";
  parameter Real c_2(nominal = 0.1) = 0 "Height of bump 2, in the unit of the signal";
  parameter Real c_3(nominal = 0.1) = 0 "Height of bump 3, in the unit of the signal";
  parameter Real c_4(nominal = 0.1) = 0 "Height of bump 4, in the unit of the signal";
  parameter Real c_5(nominal = 0.1) = 0 "Height of bump 5, in the unit of the signal";
  parameter Real c_6(nominal = 0.1) = 0 "Height of bump 6, in the unit of the signal";
  parameter Real c_7(nominal = 0.1) = 0 "Height of bump 7, in the unit of the signal";
  parameter Real c_8(nominal = 0.1) = 0 "Height of bump 8, in the unit of the signal";
  parameter Real c_9(nominal = 0.1) = 0 "Height of bump 9, in the unit of the signal";
  parameter Real c_10(nominal = 0.1) = 0 "Height of bump 10, in the unit of the signal";
  parameter Real c_11(nominal = 0.1) = 0 "Height of bump 11, in the unit of the signal";
  parameter Real c_12(nominal = 0.1) = 0 "Height of bump 12, in the unit of the signal";
  parameter Real c_13(nominal = 0.1) = 0 "Height of bump 13, in the unit of the signal";
  parameter Real c_14(nominal = 0.1) = 0 "Height of bump 14, in the unit of the signal";
  parameter Real c_15(nominal = 0.1) = 0 "Height of bump 15, in the unit of the signal";
  parameter Real c_16(nominal = 0.1) = 0 "Height of bump 16, in the unit of the signal";
  parameter Real c_17(nominal = 0.1) = 0 "Height of bump 17, in the unit of the signal";
  Real r(unit = "1") "Distance from where the curve begins, in bumps";
equation
  y = u + c_1 * max(0.0, 1 - ((r - 0) / 2)^2)^3
    + c_2 * max(0.0, 1 - ((r - 1) / 2)^2)^3
    + c_3 * max(0.0, 1 - ((r - 2) / 2)^2)^3
    + c_4 * max(0.0, 1 - ((r - 3) / 2)^2)^3
    + c_5 * max(0.0, 1 - ((r - 4) / 2)^2)^3
    + c_6 * max(0.0, 1 - ((r - 5) / 2)^2)^3
    + c_7 * max(0.0, 1 - ((r - 6) / 2)^2)^3
    + c_8 * max(0.0, 1 - ((r - 7) / 2)^2)^3
    + c_9 * max(0.0, 1 - ((r - 8) / 2)^2)^3
    + c_10 * max(0.0, 1 - ((r - 9) / 2)^2)^3
    + c_11 * max(0.0, 1 - ((r - 10) / 2)^2)^3
    + c_12 * max(0.0, 1 - ((r - 11) / 2)^2)^3
    + c_13 * max(0.0, 1 - ((r - 12) / 2)^2)^3
    + c_14 * max(0.0, 1 - ((r - 13) / 2)^2)^3
    + c_15 * max(0.0, 1 - ((r - 14) / 2)^2)^3
    + c_16 * max(0.0, 1 - ((r - 15) / 2)^2)^3
    + c_17 * max(0.0, 1 - ((r - 16) / 2)^2)^3;

  annotation(Documentation(info = "<html>
  <p>A sum of seventeen smooth bumps over <code>r</code> from 0 to 16, which a class that extends
  this one gives, is added to the signal. There are more of them than for forces because limits and
  dead bands have corners. It says what happens to the signal, not why: use it until the effect has
  a name. With all bumps at zero it is absent.</p>
  <h4>Reference</h4>
  <ul>
  <li>C. de Boor, <em>A Practical Guide to Splines</em> (2001)</li>
  </ul>
  </html>"));
end SignalEmpirical;
