"""Where a model's text comes from: a class of a library, or a class in a file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fmus.modelica_text import without_comments_and_strings
from foundation.errors import InputError, ModelicaError, UnknownNameError
from modelica import LIBRARY

_CLASS_NAME = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*\Z")
_WITHIN = re.compile(r"\A\s*within\b\s*([\w.]*)\s*;")
_FIRST_CLASS = re.compile(
    r"^\s*(?:within[^;]*;\s*)?(?:(?:encapsulated|partial|final)\s+)*(?:model|block|class|package)\s+(\w+)",
    re.MULTILINE,
)
_CLASS = re.compile(r"\b(?:model|block|class|package|connector|record|function|type)\s+(\w+)")


@dataclass(frozen=True)
class ModelicaSource:
    """Text that defines one class, and the libraries that it may use.

    Attributes:
        text: Modelica text that contains the class.
        class_name: The class to translate, as named inside `text`.
        file_name: Shown in messages.
        origin: The MODEL as the user wrote it.
        roots: Modelica paths (folders of library packages) beside the bundled library.
        defines: False if `text` only wraps a class of a library.
        file: Where a class is written that is a library's and yet the user's own, as in a file of
            a package's folder.
        fmu: The FMU that the text is written around (`fmus.in_series`).
    """

    text: str
    class_name: str
    file_name: str
    origin: str
    roots: tuple[Path, ...] = ()
    defines: bool = True
    file: ModelicaSource | None = None
    fmu: Path | None = None

    @property
    def written(self) -> ModelicaSource:
        """The text that the user wrote."""
        return self.file or self

    @property
    def short_name(self) -> str:
        """Last part of the class's name."""
        return self.class_name.rpartition(".")[2]

    @property
    def base_class(self) -> str:
        """Name by which another class extends this one."""
        return self.class_name if self.defines else self.origin


def library_class(name: str, roots: tuple[Path, ...] = ()) -> ModelicaSource:
    """Return the source of a class of the bundled or another library, by its full name.

    A library's class cannot be the front end's top class, so it is extended by an empty one.

    Example:
        >>> library_class("Twinproof.Plants.Positioner").text
        'model Positioner\\n  extends Twinproof.Plants.Positioner;\\nend Positioner;\\n'
    """
    short = name.rpartition(".")[2]
    text = f"model {short}\n  extends {name};\nend {short};\n"
    return ModelicaSource(text, short, f"{short}.mo", name, roots, defines=False)


def find_source(model: str, roots: tuple[Path, ...] = ()) -> ModelicaSource:
    """Return the source that a user's word for a Modelica model means.

    A file beside a `package.mo` belongs to that package, which is read with it. Of other files,
    none but the named one is read.

    Args:
        model: `Twinproof.Plants.Positioner`, `file.mo:Class.Name`, or `file.mo` (its first class).
        roots: Further Modelica paths.

    Raises:
        ModelicaError: The file is not there, is not text, holds no class, or its within-clause is
            not that of its folder.
        UnknownNameError: The file has no such class.
        InputError: The word is neither a file nor a class name.
    """
    path_text, colon, class_name = model.partition(".mo:")
    if colon or model.endswith(".mo"):
        path = Path(path_text + ".mo") if colon else Path(model)
        if not path.is_file():
            raise ModelicaError(
                "no such Modelica file", where=str(path), remedy="check the path before the colon"
            )
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError as error:
            raise ModelicaError(
                "the file is not UTF-8 text",
                where=f"{path}: byte {error.start}",
                remedy="save it as UTF-8",
            ) from error
        if not class_name:
            found = _FIRST_CLASS.search(text)
            if found is None:
                raise ModelicaError(
                    "the file defines no class",
                    where=str(path),
                    remedy="name a file that contains `model Name … end Name;`",
                )
            class_name = found[1]
        return _in_its_package(ModelicaSource(text, class_name, str(path), model, roots), path)
    if _CLASS_NAME.match(model):
        return library_class(model, roots)
    raise InputError(
        f"'{model}' is neither a file nor a Modelica class",
        where="MODEL",
        remedy="write file.fmu, file.mo:Class.Name or a class such as Twinproof.Plants.Positioner",
    )


def _in_its_package(source: ModelicaSource, path: Path) -> ModelicaSource:
    """Return the source of a file that may belong to a package by its folder."""
    clause = _WITHIN.search(without_comments_and_strings(source.text))
    within = clause[1] if clause else ""
    packages = _packages_around(path.absolute())
    package = ".".join(folder.name for folder in packages)
    if within != package:
        said = f"within {within};" if within else "no within-clause"
        raise ModelicaError(
            f"the file has {said} but stands in "
            + (f"the folder of the package {package}" if package else "no folder of a package"),
            where=f"{path}:1:1",
            remedy=f"begin it with `within {package};`"
            if package
            else f"move it beside the package.mo of {within}, or remove the clause",
        )
    if path.name != "package.mo" and not packages:
        outermost = source.class_name.partition(".")[0]
        defined = _CLASS.findall(without_comments_and_strings(source.text))
        if defined and outermost not in defined:
            raise UnknownNameError("class", source.class_name, defined, where=str(path))
        return source
    top = packages[0] if packages else path.absolute().parent
    own = source.class_name.removeprefix(f"{within}.")
    known = any(root.resolve() in (top.resolve(), top.resolve().parent) for root in source.roots)
    roots = source.roots if known or top == LIBRARY else (top, *source.roots)
    wrapped = library_class(f"{within}.{own}".strip("."), roots)
    return replace(wrapped, file=replace(source, class_name=own))


def _packages_around(path: Path) -> list[Path]:
    """Return the folders of the packages that a file belongs to, outermost first."""
    folders: list[Path] = []
    folder = path.parent.parent if path.name == "package.mo" else path.parent
    while (folder / "package.mo").is_file():
        folders.insert(0, folder)
        folder = folder.parent
    return folders


def check_libraries(folders: Sequence[Path]) -> tuple[Path, ...]:
    """Return folders of further libraries, of which each holds whole packages.

    A front end may read more than Modelica allows; what other tools would not find, or find under
    another name, is refused here, where it can be said with file and line.

    Raises:
        InputError: One is no folder, holds no package, or is one itself; or a package has no
            `package.mo`, or another name than its folder.
        ModelicaError: A file of a package says that it is in another one, or defines a class of
            another name.
    """
    for folder in folders:
        if not folder.is_dir():
            raise InputError(
                "no such folder", where=str(folder), remedy="give the folder that a library is in"
            )
        if (folder / "package.mo").is_file():
            raise InputError(
                "this folder is a package itself",
                where=str(folder),
                remedy=f"give the folder that it is in: {folder.absolute().parent}",
            )
        for inner in sorted(path for path in folder.iterdir() if path.is_dir()):
            _check_package(inner, "")
        if not any(folder.glob("*.mo")) and not any(folder.glob("*/package.mo")):
            raise InputError(
                "no Modelica package in this folder",
                where=str(folder),
                remedy="give the folder that holds the library's folder, which has a package.mo",
            )
    return tuple(folders)


def _check_package(folder: Path, outer: str) -> None:
    """Check what the text of a package's files says of their place."""
    is_package = (folder / "package.mo").is_file()
    name = f"{outer}.{folder.name}".strip(".")
    # A wrong name of the whole package first: every file's clause would be wrong with it.
    for path in sorted(folder.glob("*.mo"), key=lambda p: (p.name != "package.mo", p.name)):
        text = without_comments_and_strings(path.read_text(encoding="utf-8", errors="replace"))
        clause = _WITHIN.search(text)
        within = clause[1] if clause else ""
        if not is_package:
            if within:
                raise InputError(
                    f"the package {within} has no package.mo",
                    where=str(path),
                    remedy=f"write {folder / 'package.mo'}: within ; package {folder.name} "
                    f"end {folder.name};",
                )
            continue
        is_head = path.name == "package.mo"
        wanted = outer if is_head else name
        if clause is not None and within != wanted:
            raise ModelicaError(
                f"the file says `within {within};` but stands in "
                + (f"the package {wanted}" if wanted else "no package"),
                where=f"{path}:1:1",
                remedy=f"begin it with `within {wanted};`, or move it",
            )
        found = _CLASS.search(text)
        own = folder.name if is_head else path.stem
        if found is not None and found[1] != own:
            raise ModelicaError(
                f"the file defines {found[1]}, where Modelica looks for {own}",
                where=f"{path}:{text.count(chr(10), 0, found.start(1)) + 1}",
                remedy=f"rename the {'folder' if is_head else 'file'} to {found[1]}"
                + ("" if is_head else ".mo")
                + f", or the class to {own}",
            )
    if is_package:
        for inner in sorted(path for path in folder.iterdir() if path.is_dir()):
            _check_package(inner, name)


def library_roots(source: ModelicaSource) -> list[str]:
    """Return the Modelica paths of a source, the bundled library first."""
    return [str(LIBRARY), *(str(root) for root in source.roots)]


def library_classes(source: ModelicaSource) -> list[str]:
    """Return the full names of the classes that have a file in the source's libraries.

    Example:
        >>> "Twinproof.Plants.Pendulum" in library_classes(library_class("Any.Class"))
        True
    """
    found: list[str] = []
    for root in (LIBRARY, *source.roots):
        for path in sorted(root.rglob("*.mo")):
            within = re.search(r"\bwithin\s+([\w.]+)\s*;", path.read_text(encoding="utf-8"))
            if within and path.name != "package.mo":
                found.append(f"{within[1]}.{path.stem}")
    return found
