model StringLabels "String parameters: values that are put in, not shown by the FMU"
  parameter String maker = "somebody" "Not part of the FMU";
  parameter String model_number = maker + " 7";
  Real x(start = 1, fixed = true);
equation
  assert(x > -1, "of " + maker);
  der(x) = if maker == "somebody" then -2 * x else 0;
end StringLabels;
