"""A model beside a running machine: telemetry in, parameters, drift and the gate's decision out."""
