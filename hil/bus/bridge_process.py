"""Copy between two pseudo-terminals until the parent closes the pipe; run as a script.

Nothing but the standard library, so that it starts at once. What nobody takes is dropped, as on a
bus: a reader that died must not stop the other end.
"""

import os
import select
import sys

_BLOCK = 1 << 16
_MOST_WAITING = 1 << 18  # bytes for a reader that is slow


def copy(first: int, second: int, stop: int) -> None:
    """Copy both ways between two non-blocking descriptors until `stop` is readable."""
    other = {first: second, second: first}
    waiting = {first: b"", second: b""}
    while True:
        blocked = [file for file, rest in waiting.items() if rest]
        readable, writable, _ = select.select([first, second, stop], blocked, [])
        if stop in readable:
            return
        for source in readable:
            target = other[source]
            block = waiting[target] + os.read(source, _BLOCK)
            waiting[target] = write(target, block)[-_MOST_WAITING:]
        for target in writable:
            waiting[target] = write(target, waiting[target])


def write(target: int, block: bytes) -> bytes:
    """Write what fits and return the rest."""
    try:
        return block[os.write(target, block) :]
    except BlockingIOError:
        return block


if __name__ == "__main__":
    copy(*(int(word) for word in sys.argv[1:4]))
