"""Hardware in the loop over CAN. Nothing is here yet."""
