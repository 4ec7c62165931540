"""The floor under every folder: errors, units, files that are never left half-written."""
