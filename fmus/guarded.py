"""Foreign FMUs in a child process with limits: a crash or a hang is an error message.

An FMU is native code. The child has limits on memory, open files and the size of files, no network
where the kernel allows, a working folder of its own, and each request a time limit; it is replaced
after a number of requests. This keeps faults away from the caller. It is no prison for malicious
code: the child can read what its user can read.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import foundation.errors
from fmus.archive import check_archive, describe
from fmus.cache import cache_folder
from fmus.stepping import prepare
from fmus.wire import Message, WireError, decode, encode
from foundation.closing import Closing
from foundation.errors import FmuError, TwinproofError

_START = 60.0  # [s] for the child to be ready, on a busy machine


@dataclass(frozen=True)
class Limits:
    """What a child process may use.

    Attributes:
        memory: Address space [bytes].
        seconds: For one request [s].
        file_size: Of the largest file it may write [bytes].
        files: Open at a time.
        runs: Requests until the child is replaced.
    """

    memory: int = 4 * 1024**3
    seconds: float = 600.0
    file_size: int = 256 * 1024**2
    files: int = 256
    runs: int = 200


class Guard(Closing):
    """A child process for foreign FMUs, started when first needed. One request at a time.

    Args:
        limits: For the child.
    """

    def __init__(self, limits: Limits | None = None) -> None:
        self.limits = limits or Limits()
        self.has_network: bool | None = None
        self.starts = 0
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: socket.socket | None = None
        self._folder: Path | None = None
        self._runs = 0
        self._lock = threading.RLock()

    @property
    def is_running(self) -> bool:
        """Whether there is a child."""
        return self._process is not None

    def request(self, do: str, where: str, *, keep: bool = False, **arguments: Any) -> Any:
        """Have the child do something.

        Args:
            do: What.
            where: The file, for messages.
            keep: The child has something open and must not be replaced.
            arguments: Of the action.

        Raises:
            FmuError: The FMU crashed, took too long, or sent no sense.
            TwinproofError: What the child reports.
        """
        with self._lock:
            if self._runs >= self.limits.runs and not keep:
                self.close()
            if self._process is None:
                self._start()
            self._runs += 1
            end = time.monotonic() + self.limits.seconds
            try:
                self._send(encode({"do": do, "with": arguments}), end)
                answer = decode(lambda size: self._receive(size, end))
            except TimeoutError:
                self.close()
                raise FmuError(
                    f"the FMU did not answer within {self.limits.seconds:g} s",
                    where=where,
                    remedy="check its inputs, or give it longer with Limits(seconds=...)",
                ) from None
            except (WireError, OSError) as error:
                raise FmuError(
                    f"the FMU {self._ending()}",
                    where=where,
                    remedy="check it with `twinproof check`; it runs in a process of its own",
                ) from error
            except BaseException:
                self.close()  # an interrupted answer would be taken for the next one's
                raise
            if "error" not in answer:
                return answer["result"]
            error = _error(answer, where)
            if isinstance(error, FmuError) and not keep:
                self.close()  # what failed may have left the process in a bad way
            raise error

    def close(self) -> None:
        """End the child and remove its folder."""
        with self._lock:
            if self._connection is not None:
                self._connection.close()
            if self._process is not None:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(self._process.pid, signal.SIGKILL)
                self._process.wait()
            if self._folder is not None:
                shutil.rmtree(self._folder, ignore_errors=True)
            self._process = self._connection = self._folder = None
            self._runs = 0

    def _start(self) -> None:
        ours, theirs = socket.socketpair()
        self._folder = Path(tempfile.mkdtemp(prefix="twinproof-child-"))
        prepare()  # compiled here: the child need not write to the cache
        places = dict.fromkeys(("TMPDIR", "HOME", "TEMP"), str(self._folder))
        passed = {
            name: os.environ[name]
            for name in ("PATH", "LANG", "LC_ALL", "LD_LIBRARY_PATH", "CC")
            if name in os.environ
        }
        self._process = subprocess.Popen(
            [
                *(sys.executable, "-m", "fmus.guarded_child"),
                *(str(theirs.fileno()), json.dumps(asdict(self.limits))),
            ],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            cwd=self._folder,
            env={
                **passed,
                **places,
                "PYTHONPATH": os.pathsep.join(path or str(Path.cwd()) for path in sys.path),
                "PYTHONDONTWRITEBYTECODE": "1",
                "TWINPROOF_CACHE": str(cache_folder("fmus").parent.resolve()),
                "OMP_NUM_THREADS": "1",
                "OPENBLAS_NUM_THREADS": "1",
            },
            start_new_session=True,
        )
        theirs.close()
        self.starts += 1
        self._connection = ours
        try:
            end = time.monotonic() + _START
            self.has_network = bool(decode(lambda size: self._receive(size, end))["network"])
        except (WireError, OSError, KeyError) as error:
            self.close()
            raise FmuError(
                "the child process for foreign FMUs does not start",
                remedy="raise its limits, or run the FMU with guarded=False if you trust it",
            ) from error

    def _send(self, parts: Sequence[bytes], end: float) -> None:
        assert self._connection is not None
        for part in parts:
            self._connection.settimeout(max(end - time.monotonic(), 1e-3))
            self._connection.sendall(part)

    def _receive(self, size: int, end: float) -> bytes:
        assert self._connection is not None
        content = bytearray()
        while len(content) < size:
            self._connection.settimeout(max(end - time.monotonic(), 1e-3))
            got = self._connection.recv(min(size - len(content), 1 << 20))
            if not got:
                raise WireError("the child hung up")
            content += got
        return bytes(content)

    def _ending(self) -> str:
        """Say how the child ended, and clean up after it."""
        assert self._process is not None
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(2.0)
        status = self._process.returncode
        self.close()
        if status is None or status == -signal.SIGKILL:
            return "sent no sense, or was killed"
        if status < 0:
            return f"crashed with {signal.Signals(-status).name}"
        return f"ended its process with status {status}"


_SHARED = Guard()
atexit.register(_SHARED.close)


def is_ours(fmu: Path) -> bool:
    """Whether an FMU is one that we compiled ourselves, in the user's cache."""
    return fmu.resolve().is_relative_to(cache_folder("fmus").resolve())


def simulate_guarded(
    fmu: Path, settings: Mapping[str, Any], *, sha256: str | None = None, guard: Guard | None = None
) -> Message:
    """Run an FMU in the child; settings as `fmus.running.simulate`. Returns time and columns.

    Raises:
        FmuError: The archive is refused, the FMU crashes, hangs or fails.
        TwinproofError: As `simulate`.
    """
    check_archive(fmu, sha256=sha256)
    return (guard or _SHARED).request(
        "simulate", str(fmu), path=str(fmu.resolve()), sha256=sha256, settings=dict(settings)
    )


def ask(do: str, path: Path, *, guard: Guard | None = None, **arguments: Any) -> Any:
    """Have the shared child do something with a file; errors as `Guard.request`."""
    check_archive(path)
    return (guard or _SHARED).request(do, str(path), path=str(path.resolve()), **arguments)


class GuardedPlant(Closing):
    """A `Plant` in a child process of its own, with the same methods.

    Args:
        fmu: The file.
        limits: For the child.
        settings: As `Plant`.

    Raises:
        TwinproofError: As `Plant`, and as `Guard.request`.
    """

    def __init__(self, fmu: Path, *, limits: Limits | None = None, **settings: Any) -> None:
        check_archive(fmu, sha256=settings.get("sha256"))
        described = describe(fmu)
        self.path = fmu
        self.time = float(settings.get("start", 0.0))
        self.inputs = {v.name: v for v in described.inputs}
        self.parameters = {v.name: v for v in described.parameters}
        self._began = self.time
        self._guard = Guard(limits)
        try:
            self._number = self._guard.request(
                "open", str(fmu), path=str(fmu.resolve()), settings=settings
            )
        except BaseException:
            self._guard.close()
            raise

    def close(self) -> None:
        """End the child."""
        self._guard.close()

    def set(self, values: Mapping[str, Any]) -> None:
        """As `Plant.set`."""
        self._call("set", values=dict(values))

    def read(self) -> dict[str, float]:
        """As `Plant.read`."""
        return self._call("read")

    def step(self, length: float) -> None:
        """As `Plant.step`."""
        self._call("step", length=length)
        self.time += length

    def run(self, inputs: Any = None, **settings: Any) -> Any:
        """As `Plant.run`."""
        from fmus.running import Simulation  # noqa: PLC0415 - which imports this module

        answer = self._call("run", inputs=inputs, **settings)
        self.time = float(answer["now"])
        return Simulation(answer["time"], answer["columns"])

    def reset(
        self, parameters: Mapping[str, Any] | None = None, *, start: float | None = None
    ) -> None:
        """As `Plant.reset`."""
        self.time = float(self._call("reset", parameters=dict(parameters or {}), start=start))

    def save(self) -> int:
        """As `Plant.save`."""
        return int(self._call("save"))

    def rewind(self, state: int) -> None:
        """As `Plant.rewind`."""
        self.time = float(self._call("rewind", state=state))

    def forget(self, state: int) -> None:
        """As `Plant.forget`."""
        self._call("forget", state=state)

    def derivatives(self, of: Sequence[str], by: Sequence[str]) -> Any:
        """As `Plant.derivatives`."""
        return self._call("derivatives", of=list(of), by=list(by))

    def _call(self, method: str, **arguments: Any) -> Any:
        if not self._guard.is_running:
            raise FmuError(
                "the FMU's process has ended", where=str(self.path), remedy="open the plant again"
            )
        return self._guard.request(
            "call",
            str(self.path),
            keep=True,
            plant=self._number,
            method=method,
            arguments=arguments,
        )


def open_plant(fmu: Path, *, guarded: bool | None = None, **settings: Any) -> Any:
    """Open a plant: our own FMUs in this process, foreign ones in a child.

    Args:
        fmu: The file.
        guarded: Force one or the other.
        settings: As `Plant`; `limits` for a child.

    Returns:
        A `Plant` or a `GuardedPlant`.

    Raises:
        TwinproofError: As `Plant`.
    """
    if guarded is None:
        guarded = not is_ours(fmu)
    if guarded:
        return GuardedPlant(fmu, **settings)
    from fmus.plant import Plant  # noqa: PLC0415 - which imports this module

    settings.pop("limits", None)
    return Plant(fmu, **settings)


def _error(answer: Message, where: str) -> TwinproofError:
    kind = getattr(foundation.errors, str(answer["error"]), FmuError)
    if not (isinstance(kind, type) and issubclass(kind, TwinproofError)):
        kind = FmuError
    # Made without its own constructor: subclasses take other arguments.
    error = kind.__new__(kind)
    TwinproofError.__init__(
        error,
        str(answer.get("what", "")),
        where=str(answer.get("where") or where),
        remedy=str(answer.get("remedy", "")),
    )
    return error
