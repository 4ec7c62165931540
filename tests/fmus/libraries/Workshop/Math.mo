within Workshop;
package Math "Functions under names of their own"
  function sin "Sine"
    extends Icons.Function;
    input Units.SI.Angle u;
    output Real y;
  external "builtin" y = sin(u);
  end sin;

  function asin "Inverse sine"
    extends Icons.Function;
    input Real u;
    output Units.SI.Angle y;
  external "builtin" y = asin(u);
  end asin;

  function rounded "Sign that is smooth near zero"
    extends Icons.Function;
    input Real u;
    input Real width(min=Constants.eps) = 0.01;
    output Real y;
  algorithm
    y := tanh(u/width);
    annotation (Inline=true);
  end rounded;
end Math;
