within Twinproof.Interfaces;
partial model TranslationalEmpirical "A force drawn from data, without a law behind it"
  extends TranslationalEffect;

  parameter Real c_1(unit = "N", nominal = 10) = 0 "Force of bump 1";
  parameter Real c_2(unit = "N", nominal = 10) = 0 "Force of bump 2";
  parameter Real c_3(unit = "N", nominal = 10) = 0 "Force of bump 3";
  parameter Real c_4(unit = "N", nominal = 10) = 0 "Force of bump 4";
  parameter Real c_5(unit = "N", nominal = 10) = 0 "Force of bump 5";
  parameter Real c_6(unit = "N", nominal = 10) = 0 "Force of bump 6";
  parameter Real c_7(unit = "N", nominal = 10) = 0 "Force of bump 7";
  parameter Real c_8(unit = "N", nominal = 10) = 0 "Force of bump 8";
  parameter Real c_9(unit = "N", nominal = 10) = 0 "Force of bump 9";
  Real r(unit = "1") "Distance from where the curve begins, in bumps";
equation
  flange.f = c_1 * max(0.0, 1 - ((r - 0) / 2)^2)^3
    + c_2 * max(0.0, 1 - ((r - 1) / 2)^2)^3
    + c_3 * max(0.0, 1 - ((r - 2) / 2)^2)^3
    + c_4 * max(0.0, 1 - ((r - 3) / 2)^2)^3
    + c_5 * max(0.0, 1 - ((r - 4) / 2)^2)^3
    + c_6 * max(0.0, 1 - ((r - 5) / 2)^2)^3
    + c_7 * max(0.0, 1 - ((r - 6) / 2)^2)^3
    + c_8 * max(0.0, 1 - ((r - 7) / 2)^2)^3
    + c_9 * max(0.0, 1 - ((r - 8) / 2)^2)^3;

  annotation(Documentation(info = "<html>
  <p>A sum of nine smooth bumps over <code>r</code> from 0 to 8, which a class that extends this one
  gives. It says what acts, not why: use it until the effect has a name. With all bumps at zero
  it is absent.</p>
  <h4>Reference</h4>
  <ul>
  <li>C. de Boor, <em>A Practical Guide to Splines</em> (2001)</li>
  </ul>
  </html>"));
end TranslationalEmpirical;
