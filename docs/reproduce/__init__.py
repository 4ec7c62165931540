"""Tables and main figures of the three published works, made anew: `python -m docs.reproduce`."""
