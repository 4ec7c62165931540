model NestedFor "nested for-equations"
  Real a[2, 3];
equation
  for i in 1:2 loop
    for j in 1:3 loop
      a[i, j] = i * time + j;
    end for;
  end for;
end NestedFor;
