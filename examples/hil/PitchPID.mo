model PitchPID "The paper's controller of the wheeled pendulum as a model: PID with filtered derivative"
  parameter Real P(unit = "V/rad") = -168 "Proportional gain";
  parameter Real I(unit = "V/(rad.s)") = -800 "Integral gain";
  parameter Real D(unit = "V.s/rad") = -8.8 "Derivative gain";
  parameter Real N(unit = "rad/s") = 100 "Corner of the derivative's filter";
  input Real theta_p(unit = "rad") "Pitch";
  input Real theta_p_ref(unit = "rad") "What it should be";
  output Real V(unit = "V") "Motor voltage";
  Real integral(unit = "rad.s", start = 0, fixed = true) "Of the error";
  Real smooth(unit = "rad", start = 0, fixed = true) "Error through the filter";
  Real error(unit = "rad");
equation
  error = theta_p_ref - theta_p;
  der(integral) = error;
  der(smooth) = N * (error - smooth);
  V = P * error + I * integral + D * N * (error - smooth);
end PitchPID;
