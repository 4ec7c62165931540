"""Every function that users call from Python has an example that runs."""

from __future__ import annotations

import doctest
import importlib
import inspect
import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import twinproof

# What cannot have one, with the reason.
WITHOUT: dict[str, str] = {}
_PARSER = doctest.DocTestParser()


def methods(kind: type) -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield a class's own public methods, however they are bound."""
    for name, member in vars(kind).items():
        function = getattr(member, "__func__", member)
        if not name.startswith("_") and inspect.isfunction(function):
            yield name, function


def public() -> Iterator[tuple[str, str, list[str]]]:
    """Yield (full name, name, docstrings in which its example may stand)."""
    for name in twinproof.__all__:
        found = getattr(twinproof, name)
        if inspect.ismodule(found):
            for inner in found.__all__:
                value = getattr(found, inner)
                if inspect.isfunction(value):
                    yield f"{name}.{inner}", inner, [inspect.getdoc(value) or ""]
        elif inspect.isclass(found):
            about = inspect.getdoc(found) or ""
            for method, function in methods(found):
                yield f"{name}.{method}", method, [about, inspect.getdoc(function) or ""]
        else:
            returned = str(inspect.signature(found).return_annotation)
            kinds = [n for n in twinproof.__all__ if re.search(rf"\b{n}\b", returned)]
            about = [inspect.getdoc(getattr(twinproof, kind)) or "" for kind in kinds]
            yield name, name, [inspect.getdoc(found) or "", *about]


def is_called(name: str, docstring: str) -> bool:
    code = "".join(example.source for example in _PARSER.get_examples(docstring))
    return re.search(rf"\b{name}\(", code) is not None


@pytest.mark.parametrize(
    ("full", "name", "docstrings"),
    [pytest.param(*one, id=one[0]) for one in public()],
)
def test_it_has_an_example(full: str, name: str, docstrings: list[str]) -> None:
    has_one = any(is_called(name, docstring) for docstring in docstrings)
    assert has_one != (full in WITHOUT), f"{full} has no example that calls it"


def test_the_walk_sees_what_it_should() -> None:
    seen = {full for full, _, _ in public()}
    assert seen >= {"improve", "Improved.plot", "Recording.from_frame", "Model.of", "run_study"}
    assert not is_called("plot", ">>> a.plotted()\n")


MODULES = sorted(
    {
        found.__module__
        for name in twinproof.__all__
        for found in [getattr(twinproof, name)]
        if not inspect.ismodule(found)
    }
    | {getattr(twinproof.calibration, name).__module__ for name in twinproof.calibration.__all__}
)


@pytest.mark.parametrize("module", MODULES)
def test_the_examples_run(module: str) -> None:
    found = doctest.testmod(
        importlib.import_module(module),
        optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS,
    )
    assert found.failed == 0
