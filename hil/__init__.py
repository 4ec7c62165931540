"""Controllers against a plant's FMU: over a CAN bus in real time, or offline in thousands."""
