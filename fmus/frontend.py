"""Modelica text in, typed flat model out: rumoca as front end, every message with its position."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import rumoca

from fmus import lint
from fmus.aliases import without_aliases
from fmus.dae import Dae
from fmus.expressions import Literal
from fmus.modelica_text import class_spans, without_comments_and_strings
from fmus.reader import Reader
from fmus.sources import ModelicaSource, library_classes, library_roots
from foundation.errors import ModelicaError, UnknownNameError, UnsupportedModelError

_NOWHERE = "text of the model/"
_POSITION = re.compile(r"\[(?P<file>[^\[\]:]+):(?P<line>\d+):(?P<column>\d+)\]")
# What the front end says in terms of its own data structures.
_PLAIN = {
    "statement without a checked DAE owner": "the function has a while-loop, break or another "
    "statement that cannot be translated",
    "missing function value definition": "a function that it calls has a while-loop, or leaves a "
    "variable without a value on some path",
    "external function entry point": "external functions cannot be translated",
    "unresolved clock schedule|clock partition": "clocks, hold and previous cannot be translated",
    "model algorithm in canonical DAE": "an algorithm section with loops, or with several "
    "variables assigned more than once, cannot be translated",
    "current-value dependency cycle": "discrete variables depend on each other's new values in a "
    "circle; use pre(…) for one of them",
    "unsupported Flat semantic owner `when assignment`": "when within a for-equation cannot be "
    "translated",
    "if-equation branches have mismatched equation counts": "the branches of an if-equation have "
    "different numbers of equations",
    "pre expression.*names a continuous coordinate": "pre(…) of a continuous variable outside of "
    "a when-clause",
}
_DOTTED = re.compile(r"[A-Za-z_]\w*(?:\.\w+)+")
_QUOTED = re.compile(r"'([^']+)'|`([^`]+)`|\b(\w+) is not a state")


def load(source: ModelicaSource) -> Dae:
    """Translate Modelica to the typed flat model, free of aliases.

    Args:
        source: Text, class and libraries.

    Raises:
        ModelicaError: The text does not parse, type-check or balance, or holds a mistake that the
            front end would swallow (see `fmus.lint`); the message names file:line:column.
        UnsupportedModelError: A construct that has no translation.

    Example:
        >>> from fmus.sources import library_class
        >>> [v.name for v in load(library_class("Twinproof.Plants.Positioner")).states]
        ['q', 'v']
    """
    return _load(source)


# Discovery loads a few hundred variants of one model, and most of them twice.
@lru_cache(maxsize=512)
def _load(source: ModelicaSource) -> Dae:
    lint.check_text(source.written)
    compiled = _compile(source)
    dae = Reader(source.short_name, source.file_name, compiled.dae, compiled.flat).read()
    lint.check_model(source.written, dae, compiled.flat["variables"].keys())
    return without_aliases(dae)


@dataclass(frozen=True)
class _Compiled:
    dae: Mapping[str, Any]
    flat: Mapping[str, Any]


def _compile(source: ModelicaSource) -> _Compiled:
    # A session remembers classes, so there is a fresh one for every model. Where it is given the
    # path of a file that exists, it also reads what stands beside it.
    path = _NOWHERE + Path(source.file_name).name
    try:
        session = rumoca.Session(roots=library_roots(source))
        model = session.loads(source.text, model=source.class_name, filename=path)
        dae = json.loads(model.to_json("dae"))
        for row in dae["source_map"]["files"]:
            row[1] = source.file_name if row[1] == path else row[1]
        return _Compiled(dae, json.loads(model.to_json("flat")))
    except rumoca.RumocaError as error:
        if not source.defines and "base class not found" in str(error):
            # The user wrote a class name and no file: positions in our wrapper mean nothing.
            known = library_classes(source)
            raise UnknownNameError("Modelica class", source.origin, known) from error
        raise _explain(source, str(error)) from error


def _explain(source: ModelicaSource, text: str) -> ModelicaError:
    """Turn the front end's message into one line that starts with file:line:column."""
    first = text.splitlines()[0].strip()
    where = _POSITION.search(text)
    written = source.written
    if where is not None:
        is_own = where["file"].startswith(_NOWHERE)
        place = f"{source.file_name if is_own else where['file']}:{where['line']}:{where['column']}"
    elif "parse source-root files" in text:
        place, first = _malformed_file(source) or (source.origin, first)
    else:
        # Syntax errors carry a position only in the diagnostics of the whole text.
        place, _ = _first_diagnostic(written.text, written.file_name)
        place = place or _search_identifier(written, first)
    message = re.sub(r"^\S+ could not be compiled: |^\w+ failed: \S+ failed in \w+: ", "", first)
    message = _POSITION.sub("", message).strip()
    for jargon, plain in _PLAIN.items():
        if re.search(jargon, message):
            return ModelicaError(f"{place}: {plain}", remedy="write it in another way")
    balance = re.match(r"unbalanced model: (\d+) equations, (\d+) unknowns", message)
    if balance is not None:
        return ModelicaError(
            f"{place}: {source.short_name} has {balance[1]} equations for {balance[2]} unknowns",
            remedy="connect every input, and give each variable exactly one equation",
        )
    is_unknown = message.startswith(("unresolved", "base class not found"))
    remedy = "declare it, or name the folder of its library with --modelica-path"
    return ModelicaError(f"{place}: {message}", remedy=remedy if is_unknown else "")


def _first_diagnostic(text: str, file_name: str) -> tuple[str, str]:
    """Return place and message of the first mistake that can be seen in one text alone."""
    for diagnostic in rumoca.validate_source(text, filename=Path(file_name).name):
        where = _POSITION.search(str(diagnostic))
        if where is not None:
            said = re.search(r"× (.*)", str(diagnostic))
            message = said[1] if said else str(diagnostic.message).splitlines()[0]
            return f"{file_name}:{where['line']}:{where['column']}", message
    return "", ""


def _malformed_file(source: ModelicaSource) -> tuple[str, str] | None:
    """Find the file of a library that does not parse: its place, and what is wrong."""
    for root in source.roots:
        for path in sorted(root.rglob("*.mo")):
            text = path.read_text(encoding="utf-8", errors="replace")
            place, message = _first_diagnostic(text, str(path))
            if place:
                return place, message
    return None


def _search_identifier(source: ModelicaSource, message: str) -> str:
    """Find what a message without position talks about: quoted or dotted names, else the class."""
    text = without_comments_and_strings(source.text)
    quoted = [
        (match[1] or match[2] or match[3]).rpartition(".")[2] for match in _QUOTED.finditer(message)
    ]
    dotted = [
        path.rsplit(".", k)[0] for path in _DOTTED.findall(message) for k in range(path.count("."))
    ]
    spans = {name: begin for name, begin, _ in class_spans(text)}
    offset = spans.get(source.class_name, 0)
    for name in (*quoted, *dotted):
        found = re.search(rf"\b{re.escape(name)}\b", text)
        if found is not None and name != source.short_name:
            offset = found.start()
            break
    line = text.count("\n", 0, offset) + 1
    return f"{source.file_name}:{line}:{offset - text.rfind(chr(10), 0, offset)}"


def with_values(dae: Dae, values: Mapping[str, float]) -> Dae:
    """Return the model with other declared parameter values.

    Raises:
        UnsupportedModelError: A name is not an independent parameter of the model.
    """
    variables = dict(dae.variables)
    for name, value in values.items():
        variable = variables.get(name)
        if variable is None or name in dae.dependent_parameters:
            raise UnsupportedModelError(
                f"'{name}' is not a parameter that can be set",
                where=dae.name,
                remedy="set an independent parameter",
            )
        variables[name] = replace(variable, binding=Literal(value))
    return replace(dae, variables=variables)
