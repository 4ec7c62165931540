"""From Modelica source to a checked model, to C, to an FMU; and everything that runs an FMU."""
