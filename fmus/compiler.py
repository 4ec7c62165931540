"""C to shared libraries, with the compiler that is there: the system's, or the one from PyPI."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from fmus.cache import cache_folder, content_key
from foundation.errors import CompilerError, InputError
from foundation.files import written_whole

_COMMON_FLAGS = ("-std=c11", "-fPIC", "-shared", "-Wl,-Bsymbolic")
_TIMEOUT = 300.0  # [s]; a first compile with zig builds its C library and takes up to a minute


@dataclass(frozen=True)
class Compiler:
    """A C compiler that works here.

    Attributes:
        command: How it is called, e.g. `("/usr/bin/cc",)`.
        version: First line of what it says about itself.
    """

    command: tuple[str, ...]
    version: str


@dataclass(frozen=True)
class Target:
    """A platform that FMUs are compiled for.

    Attributes:
        name: FMI 2.0's name of the platform, also the folder below `binaries/`.
        suffix: Suffix of shared libraries.
        zig_triple: Zig's name of the platform.
    """

    name: str
    suffix: str
    zig_triple: str


TARGETS = {
    target.name: target
    for target in (
        # An old C library, so that the FMU also loads on machines older than this one.
        Target("linux64", ".so", "x86_64-linux-gnu.2.17"),
    )
}


def find_target(name: str) -> Target:
    """Return the platform of that name.

    Raises:
        InputError: FMUs cannot be compiled for it.
    """
    if name not in TARGETS:
        raise InputError(
            f"FMUs cannot be compiled for '{name}' yet",
            where="--target",
            remedy=f"use {' or '.join(TARGETS)}",
        )
    return TARGETS[name]


@cache
def find_compiler() -> Compiler:
    """Return the C compiler to use: `$CC`, else cc, gcc or clang on the path, else PyPI's ziglang.

    Raises:
        CompilerError: There is none.
    """
    for command in _candidates():
        version = _version(command)
        if version is not None:
            return Compiler(command, version)
    raise CompilerError(
        "no C compiler was found",
        where="$CC, cc, gcc, clang, ziglang",
        remedy="install gcc, or the compiler from PyPI: pip install 'twinproof[compiler]'",
    )


def _candidates() -> list[tuple[str, ...]]:
    found: list[tuple[str, ...]] = []
    chosen = os.environ.get("CC")
    if chosen:
        found.append(tuple(shlex.split(chosen)))
    found.extend((path,) for name in ("cc", "gcc", "clang") if (path := shutil.which(name)))
    if find_spec("ziglang") is not None:
        found.append((sys.executable, "-m", "ziglang", "cc"))
    return found


def _version(command: tuple[str, ...]) -> str | None:
    try:
        done = subprocess.run(
            [*command, "--version"], capture_output=True, text=True, timeout=_TIMEOUT, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.splitlines()[0] if done.returncode == 0 and done.stdout else None


def compile_library(
    sources: Sequence[Path],
    output: Path,
    *,
    include: Sequence[Path] = (),
    flags: Sequence[str] = ("-O2", "-fvisibility=hidden"),
    target: str = "linux64",
) -> None:
    """Compile C files into one shared library.

    Args:
        sources: The C files.
        output: The library; it appears whole or not at all.
        include: Folders of header files.
        flags: Further flags; by default only symbols marked visible are exported.
        target: Platform, see `TARGETS`.

    Raises:
        CompilerError: There is no compiler, or it refused the files.
        InputError: The target is unknown.
    """
    find_target(target)
    compiler = find_compiler()
    with written_whole(output) as beside:
        command = [
            *compiler.command,
            *_COMMON_FLAGS,
            *flags,
            *(f"-I{folder}" for folder in include),
            "-o",
            str(beside),
            *map(str, sources),
            "-lm",
        ]
        _run(command)


def _run(command: Sequence[str]) -> None:
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=_TIMEOUT, check=False
        )
    except OSError as error:
        raise CompilerError(
            f"the C compiler cannot be run: {error}", where=command[0], remedy="set CC to another"
        ) from error
    except subprocess.TimeoutExpired as error:
        raise CompilerError(
            f"the C compiler took longer than {_TIMEOUT:.0f} s",
            where=command[0],
            remedy="try again on a less busy machine",
        ) from error
    if done.returncode != 0:
        errors = [line for line in done.stderr.splitlines() if "error" in line.lower()]
        raise CompilerError(
            f"the C compiler refused the code: {(errors or ['no message'])[0].strip()}",
            where=command[0],
            remedy="set CC to gcc or clang, or report the model that causes it",
        )


def shared_library(source: str, *, optimise: str = "-O2") -> Path:
    """Compile C text to a shared library in the user's cache, once for each text.

    All non-static functions are exported, and calls between them stay inside the library.

    Args:
        source: C11 text.
        optimise: Flags of the optimiser, separated by spaces.

    Returns:
        Path of the library, valid for as long as the cache is not cleared.

    Raises:
        CompilerError: There is no compiler, or it refused the text.

    Example:
        >>> import ctypes
        >>> library = ctypes.CDLL(str(shared_library("int twice(int x) { return 2 * x; }")))
        >>> library.twice(21)
        42
    """
    compiler = find_compiler()
    key = content_key(source, optimise, *_COMMON_FLAGS, *compiler.command, compiler.version)
    library = cache_folder("libraries") / f"{key}{TARGETS['linux64'].suffix}"
    if not library.is_file():
        with tempfile.TemporaryDirectory() as folder:
            text = Path(folder) / "source.c"
            text.write_text(source, encoding="utf-8")
            compile_library([text], library, flags=shlex.split(optimise))
    return library
