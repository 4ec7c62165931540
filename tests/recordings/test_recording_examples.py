"""The examples in the docstrings run, and there are some."""

import doctest
import importlib
import pkgutil

import recordings


def test_examples():
    tried = 0
    for module in pkgutil.walk_packages(recordings.__path__, "recordings."):
        result = doctest.testmod(importlib.import_module(module.name))
        assert result.failed == 0, module.name
        tried += result.attempted
    assert tried >= 20
