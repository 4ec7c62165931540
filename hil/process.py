"""A controller that is another process on the bus."""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from fmus.compiler import program
from foundation.errors import BusError, InputError

BUILT_IN = {"balance": Path(__file__).parent / "controllers" / "balance.c"}
"""Controllers in C that are compiled when they are needed."""


@dataclass(frozen=True, kw_only=True)
class ProcessSettings:
    """Another process.

    Attributes:
        command: Program and arguments; `{channel}` stands for its end of the bus, `{python}` for
            this Python. Relative programs are looked for in the usual places.
        built_in: Instead: `balance`, a PID in C for the wheeled pendulum.
        arguments: Of the built-in one.

    Raises:
        InputError: Neither or both; no such built-in.
    """

    kind: ClassVar[str] = "process"

    command: tuple[str, ...] = ()
    built_in: str = ""
    arguments: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if bool(self.command) == bool(self.built_in):
            raise InputError(
                "which process?", where="controller", remedy="give either command or built_in"
            )
        if self.built_in and self.built_in not in BUILT_IN:
            raise InputError(
                f"no built-in controller '{self.built_in}'",
                where="controller.built_in",
                remedy=f"use {', '.join(BUILT_IN)}",
            )

    def words(self, channel: str) -> list[str]:
        """Return the command line.

        Raises:
            CompilerError: There is no C compiler for the built-in one.
        """
        if self.built_in:
            source = BUILT_IN[self.built_in].read_text(encoding="utf-8")
            return [str(program(source)), channel, *self.arguments]
        places = {"channel": channel, "python": sys.executable}
        return [word.format_map(places) for word in self.command]


@contextmanager
def running(settings: ProcessSettings, channel: str) -> Generator[subprocess.Popen[bytes]]:
    """Have the process run, and end it at the end.

    Raises:
        BusError: It does not start.
    """
    words = settings.words(channel)
    try:
        process = subprocess.Popen(words, stdin=subprocess.DEVNULL)
    except OSError as error:
        raise BusError(
            f"the controller does not start: {error.strerror}",
            where=shlex.join(words),
            remedy="correct controller.command",
        ) from error
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
