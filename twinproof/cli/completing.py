"""What a shell offers for MODEL and DATA, without waiting for the numerical packages."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from fmus.modelica_text import class_spans, without_comments_and_strings
from modelica import LIBRARY

# Two lists that others have, whose packages take seconds to import; a test keeps them in step.
DATA_SUFFIXES = (*(".csv", ".parquet", ".mat", ".mf4", ".log", ".log.gz", ".blf", ".asc", ".trc"),)
METHODS = (
    *("auto", "differencing", "output-filter", "instrumental", "simulated-instruments"),
    *("recursive", "total-least-squares", "bias-compensated", "output-error", "kalman"),
)


def complete_model(
    context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Offer models: classes of libraries, of Modelica files, and FMUs."""
    roots: Iterable[Path] = context.params.get("modelica_path") or ()
    classes = [f"Twinproof.Plants.{p.stem}" for p in _members(LIBRARY / "Plants")]
    for root in roots:
        classes += (
            name
            for package in sorted(Path(root).glob("*/package.mo"))
            for name in _package(package.parent, package.parent.name)
        )
    return _offered(incomplete, [*classes, *_models_in_files(incomplete)])


def complete_data(
    _context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Offer recordings: registered data sets, and files of formats that are read."""
    return _offered(incomplete, [*_data_sets(), *_files(incomplete, DATA_SUFFIXES)])


def complete_fmu(
    _context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Offer FMUs."""
    return _offered(incomplete, _files(incomplete, (".fmu",)))


def complete_method(
    _context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Offer methods of identification."""
    return _offered(incomplete, METHODS)


def _offered(incomplete: str, words: Iterable[str]) -> list[CompletionItem]:
    return [CompletionItem(word) for word in words if word.startswith(incomplete)]


def _data_sets() -> list[str]:
    # The package itself brings pandas with it.
    package = find_spec("recordings")
    assert package is not None
    assert package.origin is not None
    registry = Path(package.origin).parent / "datasets" / "registry.toml"
    return list(tomllib.loads(registry.read_text(encoding="utf-8"))["sets"])


def _files(incomplete: str, suffixes: Sequence[str]) -> Iterator[str]:
    """Yield files of a folder as they would be typed, and its folders."""
    typed, _, _ = incomplete.rpartition("/")
    begin = f"{typed}/" if "/" in incomplete else ""
    folder = Path(begin).expanduser()
    if not folder.is_dir():
        return
    for path in sorted(folder.iterdir()):
        if path.name.startswith("."):
            continue
        if path.is_dir():
            yield f"{begin}{path.name}/"
        elif path.name.lower().endswith(tuple(suffixes)):
            yield f"{begin}{path.name}"


def _models_in_files(incomplete: str) -> Iterator[str]:
    before, colon, _ = incomplete.partition(".mo:")
    for word in _files(before + ".mo" if colon else incomplete, (".mo", ".fmu", ".ssp")):
        classes = _classes(Path(word).expanduser()) if word.endswith(".mo") else []
        if classes:
            yield from (f"{word}:{name}" for name in classes)
        else:
            yield word


def _classes(path: Path) -> list[str]:
    """Return the classes that a Modelica file defines, packages by what is in them."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return []
    names = [name for name, _, _ in class_spans(without_comments_and_strings(text))]
    return [name for name in names if not any(other.startswith(f"{name}.") for other in names)]


def _package(folder: Path, name: str) -> Iterator[str]:
    """Yield the classes of a package's folder by their full names."""
    for path in _members(folder):
        yield f"{name}.{path.stem}"
    for inner in sorted(folder.glob("*/package.mo")):
        yield from _package(inner.parent, f"{name}.{inner.parent.name}")


def _members(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("*.mo") if path.stem != "package")
