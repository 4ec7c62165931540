"""Twins of more machines than one: gateways publish frames, workers share the twins."""
