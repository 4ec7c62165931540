"""The story in real time: the plant in a thread on a virtual bus, the service with its pages."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import can

from foundation.closing import Closing
from foundation.errors import ComputationError, TwinproofError
from hil.rig import run_scenario
from hil.scenario import Scenario, read_scenario
from twin.api import make_app, served
from twin.audit import Entry
from twin.live import live_service
from twin.logs import JsonFormatter
from twin.tokens import Tokens
from twinproof.story.files import EFFECT, StoryFiles
from twinproof.story.telling import Telling

_LOOK = 0.1
_LOG = "service.log"
_FAREWELL = 10.0


class _Arm(Closing):
    """The plant with its controller, run in a thread until it is closed.

    What passes at its plug goes to the bus that the twin listens to, stamped there: a thread that
    shares the machine with the service cannot be woken on time, and real interfaces have clocks.
    """

    def __init__(self, scenario: Scenario, channel: str) -> None:
        self._scenario = scenario
        self._bus = can.Bus(channel, interface="virtual", preserve_timestamps=True)
        self._stop = threading.Event()
        self._error: TwinproofError | None = None
        self._thread = threading.Thread(target=self._run, name="arm", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            run_scenario(self._scenario, stop=self._stop, listener=self._send)
        except TwinproofError as error:
            self._error = error

    def _send(self, stamp: float, frame: can.Message) -> None:
        frame.timestamp = stamp
        self._bus.send(frame)

    @property
    def is_worn(self) -> bool:
        """Whether the friction is there."""
        return self._scenario.faults[0].happened > 0

    def check(self) -> None:
        """See to it that it runs.

        Raises:
            TwinproofError: It has failed, or its time is over.
        """
        if self._error is not None:
            raise self._error
        if not self._thread.is_alive():
            raise ComputationError("the arm's run is over, and the story is not")

    def close(self) -> None:
        """End it; its recording is written then."""
        self._stop.set()
        self._thread.join(_FAREWELL)
        self._bus.shutdown()


@dataclass(frozen=True, eq=False)
class Told:
    """A story that has come to its end.

    Attributes:
        telling: Its chapters and its ending.
        entries: Of the event log.
        began: When the service started [s since 1970].
        seconds: How long it took.
    """

    telling: Telling
    entries: tuple[Entry, ...]
    began: float
    seconds: float


def tell_live(
    folder: Path,
    say: Callable[[float, str], None],
    *,
    story: StoryFiles | None = None,
    patience: float = 240.0,
) -> Told:
    """Let the story happen, in a little more than a minute.

    Args:
        folder: For its files, which `twin audit` and `twin replay` take afterwards.
        say: Told what happens, and when [s since the service has started].
        story: Default: as it is shipped.
        patience: How long to wait for the end at most [s].

    Raises:
        InputError: The folder holds something else.
        ComputationError: It did not come to its end.
        TwinproofError: The plant or the service failed.
    """
    story = StoryFiles.bundled() if story is None else story
    story.write(folder)
    scenario = read_scenario(folder / "scenario.toml")
    channel = str(story.twin["bus"]["channel"])
    entries: list[Entry] = []
    coming: queue.SimpleQueue[list[Entry]] = queue.SimpleQueue()
    with _logged(folder / _LOG), live_service(folder / "config.toml") as service:
        service.journal.listen(coming.put)
        began, telling, was_worn = time.time(), Telling(), False
        service.start()
        with served(make_app(service, Tokens())) as server, _Arm(scenario, channel) as arm:
            say(0.0, f"the arm is on its bus; watch it: {server.url}/pages/twin?name=arm")
            while not telling.ending:
                arm.check()
                if not was_worn and arm.is_worn:
                    was_worn = True
                    say(time.time() - began, f"IN THE PLANT: {EFFECT} of {story.friction:g} N.m")
                for entry in _next(coming):
                    entries.append(entry)
                    words = telling.take(entry)
                    if words:
                        say(entry.logged - began, words)
                if time.time() - began > patience:
                    raise ComputationError(
                        f"after {patience:g} s the story still waits for '{telling.awaited}'",
                        where=str(folder / _LOG),
                        remedy="try it on a machine with less to do",
                    )
        return Told(telling, tuple(entries), began, time.time() - began)


def _next(coming: queue.SimpleQueue[list[Entry]]) -> list[Entry]:
    try:
        return coming.get(timeout=_LOOK)
    except queue.Empty:
        return []


@contextmanager
def _logged(path: Path) -> Generator[None]:
    """Send the service's log to a file: the terminal has the story."""
    log = logging.getLogger("twinproof.twin")
    before = log.level, log.propagate
    handler = logging.FileHandler(path, mode="w", encoding="utf-8")
    handler.setFormatter(JsonFormatter())
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    log.propagate = False
    try:
        yield
    finally:
        log.removeHandler(handler)
        handler.close()
        log.level, log.propagate = before
