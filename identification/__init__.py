"""From a model and a recording to parameters, to what is missing, and to an improved model."""
