"""Figures that matter, measured in full: `make bench`."""
