"""Runnable examples; importable, so that the tests can use them too."""
