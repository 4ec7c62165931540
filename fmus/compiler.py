"""C to shared libraries, with the compiler that is there: the system's, or the one from PyPI."""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import struct
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
_CROSS_FLAGS = ("-std=c11", "-shared", "-O2", "-s", "-fvisibility=hidden")
_ZIG = (sys.executable, "-m", "ziglang", "cc")
_TIMEOUT = 900.0  # [s]; a first compile with zig builds its C library, minutes on a busy machine


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
class Machine:
    """A kind of processor of a platform.

    Attributes:
        folder: FMI 3.0's name of both.
        zig: Zig's name of both.
    """

    folder: str
    zig: str


@dataclass(frozen=True)
class Target:
    """A platform that FMUs are compiled for.

    Attributes:
        name: FMI 2.0's name of the platform, also the folder below `binaries/`.
        suffix: Suffix of shared libraries.
        machines: The processors; FMI 2.0 has one file for all of them.
    """

    name: str
    suffix: str
    machines: tuple[Machine, ...]


TARGETS = {
    target.name: target
    for target in (
        # An old C library, so that the FMU also loads on machines older than this one.
        Target("linux64", ".so", (Machine("x86_64-linux", "x86_64-linux-gnu.2.17"),)),
        Target("win64", ".dll", (Machine("x86_64-windows", "x86_64-windows-gnu"),)),
        Target(
            "darwin64",
            ".dylib",
            (
                Machine("x86_64-darwin", "x86_64-macos.11.0"),
                Machine("aarch64-darwin", "aarch64-macos.11.0"),
            ),
        ),
    )
}

NATIVE = {"Windows": "win64", "Darwin": "darwin64"}.get(platform.system(), "linux64")
"""The target that is this machine."""


def find_target(name: str) -> Target:
    """Return the platform of that name.

    Raises:
        InputError: FMUs cannot be compiled for it.
    """
    if name not in TARGETS:
        raise InputError(
            f"FMUs cannot be compiled for '{name}'",
            where="--target",
            remedy=f"use {', '.join(TARGETS)}",
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
        found.append(_ZIG)
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
) -> None:
    """Compile C files into one shared library for this machine.

    Args:
        sources: The C files.
        output: The library; it appears whole or not at all.
        include: Folders of header files.
        flags: Further flags; by default only symbols marked visible are exported.

    Raises:
        CompilerError: There is no compiler, or it refused the files.
    """
    compiler = find_compiler()
    with written_whole(output) as beside:
        _run(
            [
                *compiler.command,
                *_COMMON_FLAGS,
                *flags,
                *(f"-I{folder}" for folder in include),
                "-o",
                str(beside),
                *map(str, sources),
                "-lm",
            ]
        )


def compile_target(
    sources: Sequence[Path], target: Target, identifier: str, fmi: str
) -> dict[str, bytes]:
    """Compile C files for a platform: for this one with its compiler, for another with zig.

    Args:
        sources: The C files.
        target: The platform.
        identifier: Name of the library.
        fmi: Version of the standard, which decides the names of folders.

    Returns:
        The libraries by their paths below `binaries/`.

    Raises:
        InputError: The platform is another one, and zig is not installed.
        CompilerError: There is no compiler for this platform, or it refused the files.
    """
    name = f"{identifier}{target.suffix}"
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / name
        if target.name == NATIVE and find_compiler().command != _ZIG:
            compile_library(sources, library)
            machine = native_machine(target)
            return {f"{target.name if fmi == '2' else machine}/{name}": library.read_bytes()}
        compiled: dict[str, bytes] = {}
        for machine in target.machines:
            _compile_with_zig(sources, library, machine)
            compiled[machine.folder] = library.read_bytes()
    if fmi == "2":
        return {f"{target.name}/{name}": fat_binary(list(compiled.values()))}
    return {f"{machine}/{name}": content for machine, content in compiled.items()}


def native_machine(target: Target) -> str:
    """Return FMI 3.0's name of this machine."""
    processor = {"arm64": "aarch64", "AMD64": "x86_64"}.get(platform.machine(), platform.machine())
    return f"{processor}-{target.machines[0].folder.partition('-')[2]}"


def _compile_with_zig(sources: Sequence[Path], output: Path, machine: Machine) -> None:
    if find_spec("ziglang") is None:
        raise InputError(
            f"compiling for {machine.folder} needs the compiler from PyPI",
            where="--target",
            remedy="install it: pip install 'twinproof[compiler]'",
        )
    _run(
        [*_ZIG, "-target", machine.zig, *_CROSS_FLAGS, "-o", str(output), *map(str, sources), "-lm"]
    )


_FAT_ALIGNMENT = 14  # as power of two: the page size of arm64


def fat_binary(slices: Sequence[bytes]) -> bytes:
    """Join 64-bit Mach-O libraries for several processors to one file; one alone stays as it is.

    The header is big-endian: magic and number, then for each slice its processor (copied from its
    own header), offset, size and alignment (`<mach-o/fat.h>`).
    """
    if len(slices) == 1:
        return slices[0]
    page = 1 << _FAT_ALIGNMENT
    header = struct.pack(">II", 0xCAFEBABE, len(slices))
    body = b""
    for content in slices:
        offset = page + len(body)
        processor, subtype = struct.unpack_from("<II", content, 4)
        header += struct.pack(">IIIII", processor, subtype, offset, len(content), _FAT_ALIGNMENT)
        body += content.ljust(-(-len(content) // page) * page, b"\0")
    return header.ljust(page, b"\0") + body


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
    library = cache_folder("libraries") / f"{key}{TARGETS[NATIVE].suffix}"
    if not library.is_file():
        with tempfile.TemporaryDirectory() as folder:
            text = Path(folder) / "source.c"
            text.write_text(source, encoding="utf-8")
            compile_library([text], library, flags=shlex.split(optimise))
    return library


def program(source: str) -> Path:
    """Compile C text to a program for this machine in the user's cache, once for each text.

    Raises:
        CompilerError: There is no compiler, or it refused the text.

    Example:
        >>> import subprocess
        >>> twice = program("int main(int n, char **w) { (void)w; return 2 * n; }")
        >>> subprocess.run([twice, "one argument"]).returncode
        4
    """
    compiler = find_compiler()
    flags = ("-std=c11", "-O2", "-Wall", "-Wextra")
    key = content_key(source, *flags, *compiler.command, compiler.version)
    path = cache_folder("programs") / f"{key}{'.exe' if NATIVE == 'win64' else ''}"
    if not path.is_file():
        with tempfile.TemporaryDirectory() as folder, written_whole(path) as beside:
            text = Path(folder) / "source.c"
            text.write_text(source, encoding="utf-8")
            _run([*compiler.command, *flags, "-o", str(beside), str(text), "-lm"])
        path.chmod(0o755)
    return path
