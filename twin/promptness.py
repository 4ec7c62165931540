"""No thread of the process keeps the others from their work for long."""

from __future__ import annotations

import gc
import sys

_TURN = 1e-4
"""Python's threads take turns so often [s], not every 5 ms.

Whoever waits for a frame, or has sent a piece to a reader, has the interpreter again only when the
turn of the thread that follows the twins is over: frames of serial adapters, which are stamped on
reading, would be stamped late, and 200 readers wait for a second.
"""


def be_prompt() -> None:
    """Make turns short, and have what is there now left out of the search for garbage.

    With 50 twins every such search took 0.1 to 0.2 s, in which no frame was received. To be called
    when everything is there, and again when much has changed: garbage among it is found then.
    """
    sys.setswitchinterval(min(sys.getswitchinterval(), _TURN))
    gc.unfreeze()
    gc.collect()
    gc.freeze()
