within Workshop.Interfaces;
partial model PartialTwoFlanges "Two rotational flanges"
  Flange_a flange_a "Flange of left shaft";
  Flange_b flange_b "Flange of right shaft";
end PartialTwoFlanges;
