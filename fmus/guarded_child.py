"""The child process that runs foreign FMUs: limits first, then requests until its parent leaves.

Started by `fmus.guarded`; the arguments are a file descriptor and the limits as JSON.
"""

from __future__ import annotations

import ctypes
import json
import os
import resource
import socket
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fmus.wire import Message, WireError, decode, encode

_CLONE_NEWUSER, _CLONE_NEWNET = 0x10000000, 0x40000000


def limit(limits: Mapping[str, Any]) -> bool:
    """Set this process's limits; return whether it is cut off from the network."""
    for name, value in (
        ("RLIMIT_AS", limits["memory"]),
        ("RLIMIT_FSIZE", limits["file_size"]),
        ("RLIMIT_NOFILE", limits["files"]),
        ("RLIMIT_CORE", 0),
    ):
        kind = getattr(resource, name)
        _, hard = resource.getrlimit(kind)
        most = int(value) if hard == resource.RLIM_INFINITY else min(int(value), hard)
        resource.setrlimit(kind, (most, most))
    if sys.platform != "linux":
        return False
    # A network namespace of its own has no way out; unprivileged where the kernel allows.
    unshare = ctypes.CDLL(None, use_errno=True).unshare
    return unshare(_CLONE_NEWNET) == 0 or unshare(_CLONE_NEWUSER | _CLONE_NEWNET) == 0


def main() -> None:
    """Serve requests."""
    connection = socket.socket(fileno=int(sys.argv[1]))
    is_cut_off = limit(json.loads(sys.argv[2]))

    def receive(size: int) -> bytes:
        content = bytearray(size)
        view = memoryview(content)
        while view:
            got = connection.recv_into(view)
            if got == 0:
                raise WireError("the parent left")
            view = view[got:]
        return bytes(content)

    plants: dict[int, Any] = {}
    _actions(plants)  # imports now: they are no part of a request's time
    for part in encode({"ready": True, "network": not is_cut_off}):
        connection.sendall(part)
    while True:
        try:
            request = decode(receive)
        except WireError:
            os._exit(0)
        for part in encode(_answer(request, plants)):
            connection.sendall(part)


def _answer(request: Message, plants: dict[int, Any]) -> Message:
    from foundation.errors import TwinproofError  # noqa: PLC0415 - after the limits

    try:
        return {"result": _actions(plants)[request["do"]](**request["with"])}
    except TwinproofError as error:
        return {
            "error": type(error).__name__,
            "what": error.what,
            "where": error.where,
            "remedy": error.remedy,
        }
    except MemoryError:
        return {
            "error": "FmuError",
            "what": "the FMU needs more memory than it may have",
            "where": "",
            "remedy": "give it more with Limits(memory=...)",
        }
    except Exception as error:
        return {
            "error": "FmuError",
            "what": f"the FMU failed: {type(error).__name__}: {error}",
            "where": "",
            "remedy": "check it with `twinproof check`",
        }


def _actions(plants: dict[int, Any]) -> Mapping[str, Callable[..., Any]]:
    from fmus.checking import check_directly  # noqa: PLC0415 - all after the limits
    from fmus.plant import Plant, run_many  # noqa: PLC0415 - after the limits
    from fmus.running import Fmu, Simulation  # noqa: PLC0415 - after the limits
    from fmus.variational import sensitivities as follow  # noqa: PLC0415 - after the limits

    def simulate(path: str, sha256: str | None, settings: dict[str, Any]) -> Message:
        with Fmu(Path(path), sha256=sha256) as fmu:
            run = fmu.simulate(**settings)
        return {"time": run.time, "columns": dict(run.columns)}

    def sensitivities(path: str, settings: dict[str, Any]) -> Message:
        outputs, derivatives = follow(Path(path), **settings, guarded=False)
        return {"outputs": outputs, "derivatives": derivatives}

    def many(path: str, settings: dict[str, Any]) -> Message:
        time, values = run_many(Path(path), **settings)
        return {"time": time, "values": values}

    def check(path: str) -> list[list[Any]]:
        return [[c.name, c.ok, c.detail] for c in check_directly(Path(path))]

    def system(path: str, settings: dict[str, Any]) -> Message:
        from fmus.master.ssp import read_ssp  # noqa: PLC0415 - after the limits

        with read_ssp(Path(path)) as opened:
            chosen: dict[str, Any] = {**opened.defaults, **settings}
            run = opened.system.simulate(**chosen)
        return {"time": run.time, "columns": dict(run.columns)}

    def open_plant(path: str, settings: dict[str, Any]) -> int:
        number = max(plants, default=0) + 1
        settings["parameters"] = _values(settings.get("parameters"))
        plants[number] = Plant(Path(path), **settings)
        return number

    def call(plant: int, method: str, arguments: dict[str, Any]) -> Any:
        opened = plants[plant]
        if method == "close":
            opened.close()
            del plants[plant]
            return None
        if method == "save":
            saved = opened.save()
            key = max((k for p, k in _STATES if p == plant), default=0) + 1
            _STATES[plant, key] = saved
            return key
        if method == "rewind":
            opened.rewind(_STATES[plant, arguments["state"]])
        elif method == "forget":
            opened.forget(_STATES.pop((plant, arguments["state"])))
        elif method == "run":
            run = opened.run(**arguments)
            assert isinstance(run, Simulation)
            return {"time": run.time, "columns": dict(run.columns), "now": opened.time}
        elif method in ("set", "reset"):
            name = "values" if method == "set" else "parameters"
            getattr(opened, method)(**{**arguments, name: _values(arguments.get(name))})
        else:
            return getattr(opened, method)(**arguments)
        return opened.time

    return {
        "simulate": simulate,
        "sensitivities": sensitivities,
        "many": many,
        "check": check,
        "system": system,
        "open": open_plant,
        "call": call,
    }


_STATES: dict[tuple[int, int], Any] = {}


def _values(values: Mapping[str, Any] | None) -> dict[str, Any]:
    return {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in (values or {}).items()
    }


if __name__ == "__main__":
    main()
