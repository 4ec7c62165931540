model HeatRod "for-equation with neighbours (heat conduction)"
  parameter Integer n = 12;
  Real T[n](start = {1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0}, each fixed = true);
equation
  der(T[1]) = T[2] - T[1];
  for i in 2:n - 1 loop
    der(T[i]) = T[i - 1] - 2 * T[i] + T[i + 1];
  end for;
  der(T[n]) = T[n - 1] - T[n];
end HeatRod;
