"""Two pseudo-terminals joined back to back: a CAN bus between processes without any hardware."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from foundation.errors import BusError


@contextmanager
def bridged_terminals() -> Generator[tuple[str, str]]:
    """Give the names of two terminals; what is written to one can be read from the other.

    A process of its own copies, so that neither end waits for the other.

    Raises:
        BusError: The system has no pseudo-terminals.

    Example:
        >>> from hil.bus.slcan import SlcanBus
        >>> from can import Message
        >>> with bridged_terminals() as (a, b), SlcanBus(a) as plant, SlcanBus(b) as controller:
        ...     plant.send(Message(arbitration_id=0x101, is_extended_id=False, data=b"abc"))
        ...     frame = controller.recv(5.0)
        >>> bytes(frame.data)
        b'abc'
    """
    files: list[int] = []
    try:
        try:
            import tty  # noqa: PLC0415 - not there on Windows

            pairs = [os.openpty(), os.openpty()]
        except (OSError, ImportError) as error:
            raise BusError(
                f"no pseudo-terminal can be opened: {error}",
                where="bus.channel",
                remedy="use interface 'virtual', or a real adapter",
            ) from error
        for ours, theirs in pairs:
            files += [ours, theirs]
            # The far ends stay open here: a terminal whose last user leaves hangs up for good.
            tty.setraw(theirs)
            os.set_blocking(ours, False)
        stop, held = os.pipe()
        files += [stop, held]
        ours = [pair[0] for pair in pairs]
        process = subprocess.Popen(
            [
                *(sys.executable, "-I", "-S", str(Path(__file__).with_name("bridge_process.py"))),
                *map(str, (*ours, stop)),
            ],
            pass_fds=(*ours, stop),
            stdin=subprocess.DEVNULL,
        )
        try:
            yield os.ttyname(pairs[0][1]), os.ttyname(pairs[1][1])
        finally:
            os.close(held)
            files.remove(held)
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
    finally:
        for file in files:
            os.close(file)
