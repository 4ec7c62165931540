within Workshop;
package Constants "Of nature"
  final constant Real pi = 2*Math.asin(1.0);
  final constant Real eps = 1.e-15 "Biggest number with 1.0 + eps = 1.0";
  final constant Units.SI.Acceleration g_n = 9.80665 "Standard acceleration of gravity";
end Constants;
