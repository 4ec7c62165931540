"""Work in a process of its own: the twins keep their core, and a stop does not wait for it."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, ParamSpec, TypeVar

from foundation.errors import ComputationError, TwinproofError

_LOG = logging.getLogger("twinproof.twin")
P = ParamSpec("P")
T = TypeVar("T")
_LOOK = 0.2
_COURTESY = 10
_CONTEXT = (
    multiprocessing.get_context("forkserver")
    if "forkserver" in multiprocessing.get_all_start_methods()
    else multiprocessing.get_context("spawn")
)
_PRELOADED = ["twin.diagnosis", "twin.improvement", "twin.verification"]
"""What is done apart: importing it takes seconds, which count between a drift and its end."""


def prepare() -> None:
    """Have a process import what is done apart, to be copied when it is needed; no waiting."""
    if _CONTEXT.get_start_method() == "forkserver":
        _CONTEXT.set_forkserver_preload(_PRELOADED)
        with _undisturbed():
            forkserver.ensure_running()


def apart(stop: threading.Event, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Call a function in a process of its own, at low priority.

    Args:
        stop: When it is set, the process is ended, with compilers and whatever else it runs.
        function: Importable by name; like its arguments and its result it must be picklable.
        args, kwargs: Of it.

    Raises:
        TwinproofError: What the function raised.
        ComputationError: It was stopped, or its process died.
    """
    prepare()
    ours, theirs = _CONTEXT.Pipe(duplex=False)
    # Only this process holds its end of that: it is closed when this process is gone.
    ending, alive = _CONTEXT.Pipe(duplex=False)
    process = _CONTEXT.Process(
        target=_work, args=(theirs, ending, function, args, kwargs), daemon=True
    )
    with _undisturbed():
        process.start()
    theirs.close()
    ending.close()
    try:
        while not ours.poll(_LOOK):
            if stop.is_set():
                _LOG.info("abandoned", extra={"work": function.__name__})
                raise ComputationError("it was stopped", remedy="start it again")
        done, value = ours.recv()
    except EOFError as error:
        process.join()
        raise ComputationError(
            f"its process ended with status {process.exitcode}", remedy="see its messages"
        ) from error
    finally:
        _end(process)
        process.close()
        ours.close()
        alive.close()
    if not done:
        raise value
    return value


def _end(process: BaseProcess) -> None:
    """End a process and what it has started: a compiler would go on, and hold our terminal."""
    if hasattr(os, "killpg") and process.pid is not None:
        # It may not lead its group yet, or be gone.
        with suppress(OSError):
            os.killpg(process.pid, signal.SIGTERM)
    process.terminate()
    process.join()


@contextmanager
def _undisturbed() -> Generator[None]:
    """Keep Ctrl-C, which reaches all processes of a terminal, from those that begin here.

    The service ends them in order. A process inherits what the thread that starts it has blocked.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # It would unblock the signal when it starts beside the first process.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Apart(ThreadPoolExecutor):
    """An executor whose work is done apart, one piece after the other."""

    def __init__(self, stop: threading.Event, name: str) -> None:
        super().__init__(1, thread_name_prefix=name)
        self._stop = stop

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Have a function called."""
        return super().submit(apart, self._stop, fn, *args, **kwargs)


def _work(
    pipe: Connection, ending: Connection, function: Callable[..., Any], args: Any, kwargs: Any
) -> None:
    if hasattr(os, "setpgrp"):
        os.setpgrp()
    if hasattr(os, "nice"):
        os.nice(_COURTESY)
    threading.Thread(target=_follow, args=(ending,), daemon=True).start()
    try:
        result = True, function(*args, **kwargs)
    except TwinproofError as error:
        result = False, error
    except Exception as error:
        result = False, ComputationError(f"{type(error).__name__}: {error}")
    pipe.send(result)


def _follow(ending: Connection) -> None:
    """End with the service, also if that is killed."""
    ending.poll(None)
    os._exit(1)
