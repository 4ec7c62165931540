"""One task at a time in a process of its own, with progress, that can be ended at any moment.

The process is started early, so that its imports are done when the first task comes. It is told
tasks as lines of JSON on its standard input, and answers in lines of JSON on a copy of its standard
output; what a compiler or a model prints goes to standard error.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Any

from foundation.progress import Spoken


@dataclass(frozen=True)
class Job:
    """A task that was asked for.

    Attributes:
        task: Its name.
        status: `running`, `done`, `failed` or `cancelled`.
        progress: What is being done.
        began: Unix time.
        seconds: How long it took; 0 while it runs.
        error: What is wrong, by `what`, `where`, `remedy`, `field`.
    """

    task: str
    status: str = "running"
    progress: str = ""
    began: float = field(default_factory=time.time)
    seconds: float = 0.0
    error: Mapping[str, str] = field(default_factory=dict[str, str])

    @property
    def running(self) -> bool:
        """It has not come to an end."""
        return self.status == "running"


class Worker:
    """Runs tasks in a process.

    Args:
        folder: The project's.
        finished: Told of every job that came to an end; called from another thread.
    """

    def __init__(self, folder: Path, finished: Callable[[Job], None] = lambda _: None) -> None:
        self._folder = folder
        self._finished = finished
        self._lock = threading.Lock()
        self.job: Job | None = None
        self._process = self._start()

    @property
    def busy(self) -> bool:
        """A task is running."""
        return self.job is not None and self.job.running

    def run(self, task: str, arguments: Mapping[str, str] | None = None) -> bool:
        """Begin a task; False if another one is running."""
        with self._lock:
            if self.busy:
                return False
            if self._process.poll() is not None:
                self._process = self._start()
            self.job = Job(task)
            stdin = _pipe(self._process.stdin)
            stdin.write(json.dumps({"task": task, "arguments": dict(arguments or {})}) + "\n")
            stdin.flush()
            return True

    def cancel(self) -> None:
        """End the running task; what it had written before is whole, what it had not is absent."""
        with self._lock:
            if self.job is None or not self.busy:
                return
            self._end("cancelled", {})
            _kill(self._process)
            self._process = self._start()

    def close(self) -> None:
        """End the process."""
        with self._lock:
            _kill(self._process)

    def _start(self) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", "twinproof.workbench.worker", str(self._folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            # A group of its own: a compiler that it started ends with it.
            start_new_session=True,
        )
        threading.Thread(target=self._listen, args=(process,), daemon=True).start()
        return process

    def _listen(self, process: subprocess.Popen[str]) -> None:
        for line in _pipe(process.stdout):
            with self._lock:
                if process is self._process:
                    self._heard(json.loads(line))
        with self._lock:
            if process is self._process and self.busy:
                what = f"the computation ended unexpectedly (status {process.wait()})"
                self._end("failed", {"what": what, "remedy": "look at the terminal, try again"})

    def _heard(self, said: Mapping[str, Any]) -> None:
        if self.job is None:
            return
        if "progress" in said:
            self.job = replace(self.job, progress=str(said["progress"]))
        elif "error" in said:
            self._end("failed", said["error"])
        else:
            self._end("done", {})

    def _end(self, status: str, error: Mapping[str, str]) -> None:
        assert self.job is not None
        seconds = time.time() - self.job.began
        self.job = replace(self.job, status=status, seconds=seconds, error=error)
        self._finished(self.job)


def _pipe(stream: IO[str] | None) -> IO[str]:
    assert stream is not None
    return stream


def _kill(process: subprocess.Popen[str]) -> None:
    if process.poll() is None:
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
        process.wait()
    _pipe(process.stdin).close()


def main(folder: Path) -> None:
    """Serve tasks until standard input ends."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)

    def say(**said: Any) -> None:
        answers.write(json.dumps(said) + "\n")
        answers.flush()

    # Slow, and the pipe is open by now.
    from twinproof.workbench import tasks  # noqa: PLC0415
    from twinproof.workbench.look import said  # noqa: PLC0415

    for line in sys.stdin:
        asked = json.loads(line)
        try:
            progress = Spoken(lambda text: say(progress=text))
            tasks.run(asked["task"], folder, asked["arguments"], progress)
        except tasks.FieldError as error:
            say(error={**said(error.error), "field": error.field})
        except tasks.TwinproofError as error:
            say(error={**said(error), "field": ""})
        except Exception as error:
            traceback.print_exc()
            what = f"a fault of ours: {type(error).__name__}: {error}"
            say(error={"what": what, "where": "", "remedy": "see the terminal, and report it"})
        else:
            say(done=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
