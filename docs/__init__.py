"""Documentation, and the program that writes the reproduction pages."""
