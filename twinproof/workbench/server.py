"""The server: one page, the project's files, and the worker, for one user on this machine."""

from __future__ import annotations

import asyncio
import json
import shlex
import shutil
from collections.abc import Awaitable, Mapping
from dataclasses import asdict
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from tornado import web
from tornado.escape import url_unescape
from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets

from foundation.errors import InputError, TwinproofError
from foundation.files import write_text
from recordings import list_sets
from twinproof.workbench import curves, mapping
from twinproof.workbench.project import UPLOADS, Project, Step
from twinproof.workbench.worker import Job, Worker

STATIC = Path(__file__).parent / "static"
# Not imported from the report, whose packages take seconds.
STYLE = Path(__file__).parents[1] / "report" / "templates" / "style.css"
HERE = "127.0.0.1"
_LARGEST = 64 * 2**30
_RESULTS = ("compare", "diagnose", "change", "ladder", "improve", "export")
_MODELS = "Twinproof.Plants."


class Workbench:
    """What all requests share: the project, the worker, and what is to be done after this."""

    def __init__(self, project: Project) -> None:
        self.project = project
        self._look_again = False
        self._next: tuple[str, dict[str, str]] | None = None
        self.worker = Worker(project.folder, self._finished)

    def look(self) -> None:
        """Look at what was chosen, now or once the running task is done."""
        self._look_again = not self.worker.run("look")

    def begin(self, task: str, arguments: dict[str, str]) -> None:
        """Begin a task, at once or after a look that is being taken.

        Raises:
            InputError: Another one is running.
        """
        if self._next is None:
            if self.worker.run(task, arguments):
                return
            job = self.worker.job
            if job is not None and job.task == "look":
                self._next = (task, arguments)
                return
        raise InputError("another computation is running", remedy="wait for it, or cancel it first")

    def cancel(self) -> None:
        """End what is running, and forget what was to come."""
        self._next = None
        self.worker.cancel()

    @property
    def job(self) -> Job | None:
        """What is running, or ran last; what waits its turn is running."""
        if self._next is not None:
            return Job(self._next[0])
        return Job("look") if self._look_again else self.worker.job

    def _finished(self, _job: Job) -> None:
        # In a moment: the worker's lock is still held by who tells us.
        self._loop.call_soon_threadsafe(self._go_on)

    def _go_on(self) -> None:
        if self._next is not None:
            task, arguments = self._next
            if self.worker.run(task, arguments):
                self._next = None
        elif self._look_again:
            self.look()

    def attach(self) -> None:
        """Remember the event loop that serves."""
        self._loop = asyncio.get_running_loop()

    def state(self) -> dict[str, Any]:
        """Return everything that the page shows, without curves and pieces of page."""
        project = self.project
        choices = project.choices
        question = project.question()
        results: dict[str, Any] = {}
        for name in _RESULTS:
            found = project.result(name)
            if found is not None:
                path = project.results / f"{name}.html"
                results[name] = {
                    "stamp": path.stat().st_mtime_ns if path.exists() else 0,
                    "stale": found.get("made_with") != question,
                    "command": found.get("command", ""),
                    **_shown(name, found),
                }
        job = self.job
        look = project.cache / "look.json"
        return {
            "folder": str(project.folder),
            "choices": asdict(choices),
            "present_model": choices.present_model,
            "look": json.loads(look.read_text(encoding="utf-8")) if look.is_file() else None,
            "results": results,
            "job": None if job is None else asdict(job),
            "commands": _commands(project),
            "models": [*_library(), *project.files("models", (".mo", ".fmu"))],
            "recordings": [
                *(s.name for s in list_sets()),
                *project.files("recordings", [e for e in UPLOADS["recordings"] if e != ".dbc"]),
            ],
            "dbcs": project.files("recordings", (".dbc",)),
            "exports": _exports(project),
        }


def _library() -> list[str]:
    from modelica import LIBRARY  # noqa: PLC0415 - a constant, but its package is imported late

    plants = LIBRARY / "Plants"
    return sorted(_MODELS + p.stem for p in plants.glob("*.mo") if p.stem != "package")


def _shown(name: str, found: Mapping[str, Any]) -> dict[str, Any]:
    if name == "diagnose":
        refitted = [row for row in found["ranking"] if row["refitted"]]
        candidates = [
            ",".join(
                [
                    f"{row['effect']}@{row['place']}",
                    *(f"{k}={p['value']:.6g}" for k, p in row["parameters"].items()),
                ]
            )
            for row in refitted
        ]
        proposal = found.get("proposal")
        return {
            "verdict": found["verdict"],
            "candidates": candidates + ([proposal["add"]] if proposal else []),
        }
    if name == "change":
        return {key: found[key] for key in ("label", "name", "before", "after")}
    return {}


def _commands(project: Project) -> list[str]:
    choices = project.choices
    if not choices.model or not choices.recording:
        return []
    lines = [project.command(name) for name in ("compare", "identify", "diagnose")]
    if choices.steps:
        step = choices.steps[-1]
        # A name of its own: the accepted file has fitted values of the model's own parameters too.
        path = f"{step.model.rpartition(':')[2]}.mo"
        added = "".join(f" --add {text}" for text in step.additions)
        libraries = "".join(f" {shlex.quote(word)}" for word in project.library_options())
        lines.append(f"twinproof extend {choices.model}{added}{libraries} -o {path}")
    if choices.holdout:
        lines.append(
            project.command(
                "improve",
                model=choices.model,
                more=["--holdout", choices.holdout, "-o", "improved"],
            )
        )
    return lines


def _exports(project: Project) -> list[str]:
    improved = project.folder / "improved"
    found = [
        f"improved/{path.name}"
        for path in sorted(improved.glob("*"))
        if path.is_file() and not path.name.startswith(".")
    ]
    return [*project.files("models", (".mo", ".fmu")), *found]


class Handler(web.RequestHandler):
    """Base of all handlers: this machine only, and mistakes as JSON.

    A page of another origin cannot reach a server that answers to its own host name only (no DNS
    rebinding), and that takes changes from its own pages only (no forged requests).
    """

    def initialize(self, bench: Workbench) -> None:
        """Take what all requests share."""
        self.bench = bench

    def prepare(self) -> Awaitable[None] | None:
        """Refuse who is not this machine's own page."""
        host = self.request.host.rpartition(":")[0] or self.request.host
        origin = self.request.headers.get("Origin")
        foreign = origin is not None and urlsplit(origin).netloc != self.request.host
        if host not in (HERE, "localhost") or foreign:
            raise web.HTTPError(403, "this workbench is for this machine only")
        return None

    def set_default_headers(self) -> None:
        """Let nothing be loaded from elsewhere."""
        self.set_header(
            "Content-Security-Policy",
            "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
            "frame-ancestors 'self'",
        )
        self.set_header("Cache-Control", "no-cache")
        self.set_header("X-Content-Type-Options", "nosniff")

    def body(self) -> dict[str, Any]:
        """Return the request's JSON object."""
        try:
            found = json.loads(self.request.body or b"{}")
        except ValueError:
            found = None
        if not isinstance(found, dict):
            raise InputError("the request is no JSON object", remedy="reload the page")
        return {str(k): v for k, v in found.items()}

    def answer(self, value: Mapping[str, Any]) -> None:
        """Answer with JSON."""
        self.set_header("Content-Type", "application/json")
        self.finish(json.dumps(value, ensure_ascii=False))

    def write_error(self, status_code: int, **kwargs: Any) -> None:  # noqa: ARG002
        """Answer mistakes as the page shows them, beside the field."""
        error = kwargs.get("exc_info", (None, None, None))[1]
        what, remedy = self._reason, ""
        if isinstance(error, TwinproofError):
            self.set_status(422)
            what, remedy = error.what, error.remedy
        elif isinstance(error, OSError):
            what, remedy = f"{error.strerror or error}", "check the project's folder"
        self.answer({"what": what, "remedy": remedy})

    def log_exception(self, typ: Any, value: Any, tb: Any) -> None:
        """Keep users' mistakes out of the terminal."""
        if not isinstance(value, TwinproofError):
            super().log_exception(typ, value, tb)


class Page(Handler):
    """The page."""

    def get(self) -> None:
        """Send it."""
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish((STATIC / "index.html").read_bytes())


class Style(Handler):
    """The report's style sheet, which the page shares."""

    def get(self) -> None:
        """Send it."""
        self.set_header("Content-Type", "text/css; charset=utf-8")
        self.finish(STYLE.read_bytes())


class Static(web.StaticFileHandler):
    """Scripts and styles."""

    def set_extra_headers(self, path: str) -> None:  # noqa: ARG002
        """Let a newer version be seen at once."""
        self.set_header("Cache-Control", "no-cache")


class State(Handler):
    """What there is, and changes of the form's fields."""

    def get(self) -> None:
        """Send the state."""
        self.answer(self.bench.state())

    def patch(self) -> None:
        """Change fields; look at what was chosen."""
        self.bench.project.choose({name: str(text) for name, text in self.body().items()})
        self.bench.look()
        self.answer(self.bench.state())


class Channel(Handler):
    """What is said of one channel, or of time."""

    def patch(self, name: str) -> None:
        """Change it."""
        said = {key: str(text) for key, text in self.body().items()}
        mapping.change_tables(self.bench.project.map_file, name, said)
        self.bench.look()
        self.answer(self.bench.state())

    def delete(self, name: str) -> None:
        """Say nothing of it any more."""
        path = self.bench.project.map_file
        table: Mapping[str, Any] = mapping.read_tables(path).get("channels", {}).get(name, {})
        mapping.change_tables(path, name, dict.fromkeys(table, ""))
        self.bench.look()
        self.answer(self.bench.state())


@web.stream_request_body
class Upload(Handler):
    """Takes a file as it comes, however large."""

    def prepare(self) -> None:
        """Check its name before anything is taken."""
        super().prepare()
        _, _, folder, name = self.request.path.split("/", 3)
        name = url_unescape(name, plus=False)
        self._beside: Path | None = None
        self._target = self.bench.project.upload_path(folder, name)
        self._target.parent.mkdir(parents=True, exist_ok=True)
        self._beside = self._target.with_name(f".{self._target.name}.part")
        self._file = self._beside.open("wb")

    def data_received(self, chunk: bytes) -> None:
        """Write a piece."""
        self._file.write(chunk)

    def put(self, folder: str, _name: str) -> None:
        """Give the whole file its name, and choose it."""
        assert self._beside is not None
        self._file.close()
        if self._beside.stat().st_size == 0:
            raise InputError(f"'{self._target.name}' is empty", remedy="give a file with content")
        self._beside.replace(self._target)
        self.answer({"word": f"{folder}/{self._target.name}"})

    def on_finish(self) -> None:
        """Leave nothing half-written."""
        self._clean()

    def on_connection_close(self) -> None:
        """Leave nothing half-written."""
        self._clean()

    def _clean(self) -> None:
        if self._beside is not None:
            self._file.close()
            self._beside.unlink(missing_ok=True)


class Jobs(Handler):
    """Begins and ends tasks."""

    def post(self) -> None:
        """Begin one."""
        asked = self.body()
        task = str(asked.pop("task", ""))
        if task not in ("look", "compare", "identify", "diagnose", "propose", *_LATER):
            raise InputError(f"there is no task '{task}'", remedy="reload the page")
        self.bench.begin(task, {k: str(v) for k, v in asked.items()})
        self.answer(self.bench.state())

    def delete(self) -> None:
        """End the running one."""
        self.bench.cancel()
        self.answer(self.bench.state())


_LATER = ("score", "improve", "export")


class Steps(Handler):
    """Accepts the proposed step, and takes the last one back."""

    def post(self) -> None:
        """Accept."""
        project = self.bench.project
        change = project.result("change")
        proposed = project.cache / "proposal.mo"
        if change is None or not proposed.is_file() or change["made_with"] != project.question():
            raise InputError(
                "there is no change to accept", remedy="show the change of an effect first"
            )
        path = project.folder / "models" / f"{change['name']}.mo"
        write_text(path, proposed.read_text(encoding="utf-8"))
        proposed.unlink()
        project.accept(Step(tuple(change["additions"]), f"models/{path.name}:{change['name']}"))
        self.bench.look()
        self.answer(self.bench.state())

    def delete(self) -> None:
        """Undo."""
        self.bench.project.undo()
        self.bench.look()
        self.answer(self.bench.state())


class Demo(Handler):
    """Sets up the bundled demo in this project."""

    def post(self) -> None:
        """Copy its files, choose them."""
        project = self.bench.project
        with as_file(files("twinproof") / "demo_data") as folder:
            (project.folder / "recordings").mkdir(parents=True, exist_ok=True)
            for name in ("balancing.blf", "held_out.blf", "wheeled_pendulum.dbc"):
                shutil.copyfile(folder / name, project.folder / "recordings" / name)
            shutil.copyfile(folder / "channels.toml", project.map_file)
        project.choose(
            {
                "model": "Twinproof.Plants.WheeledPendulum",
                "recording": "recordings/balancing.blf",
                "holdout": "recordings/held_out.blf",
                "dbc": "recordings/wheeled_pendulum.dbc",
            }
        )
        self.bench.look()
        self.answer(self.bench.state())


class Piece(Handler):
    """A result's piece of page."""

    def get(self, name: str) -> None:
        """Send it."""
        if name not in _RESULTS:
            raise web.HTTPError(404)
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish(self.bench.project.page(name))


class Curves(Handler):
    """Curves of the comparison, as few points as the page asks for."""

    def get(self) -> None:
        """Send numbers of 32 bit: time and curves, one after another, the time from its begin."""
        folder = self.bench.project.cache / "compare"
        about = curves.about(folder)
        if about is None:
            raise web.HTTPError(404)
        begin = float(self.get_query_argument("begin", "-inf"))
        end = float(self.get_query_argument("end", "inf"))
        points = min(max(int(self.get_query_argument("points", "4000")), 100), 200_000)
        time, values = curves.view(folder, begin, end, points)
        self.set_header("Content-Type", "application/octet-stream")
        # A float of 32 bit cannot hold the time of a long record to a millisecond.
        self.finish(time.tobytes() + b"".join(np.asarray(v, np.float32).tobytes() for v in values))


class About(Handler):
    """What the comparison's curves are."""

    def get(self) -> None:
        """Send it."""
        folder = self.bench.project.cache / "compare"
        about = curves.about(folder)
        if about is None:
            raise web.HTTPError(404)
        time = np.load(folder / "time.npy", mmap_mode="r")
        self.answer({**about, "begin": float(time[0]), "end": float(time[-1])})


class Download(Handler):
    """The project's results, to look at or to keep."""

    def get(self, path: str) -> None:
        """Send one of the files that the state lists."""
        if path not in _exports(self.bench.project):
            raise web.HTTPError(404)
        found = self.bench.project.folder / path
        if found.suffix == ".html":
            self.set_header("Content-Type", "text/html; charset=utf-8")
            # A report's style is inside it.
        else:
            self.set_header("Content-Type", "application/octet-stream")
            self.set_header("Content-Disposition", f'attachment; filename="{found.name}"')
        self.finish(found.read_bytes())


def application(bench: Workbench) -> web.Application:
    """Return the web application."""
    given = {"bench": bench}
    return web.Application(
        [
            (r"/", Page, given),
            (r"/report.css", Style, given),
            (r"/static/(.*)", Static, {"path": str(STATIC)}),
            (r"/api/state", State, given),
            (r"/api/channels/(.+)", Channel, given),
            (r"/upload/(recordings|models)/([^/]+)", Upload, given),
            (r"/api/jobs", Jobs, given),
            (r"/api/steps", Steps, given),
            (r"/api/demo", Demo, given),
            (r"/api/pieces/(\w+)", Piece, given),
            (r"/api/curves", Curves, given),
            (r"/api/about", About, given),
            (r"/files/(.+)", Download, given),
        ]
    )


async def serve(project: Project, port: int, ready: asyncio.Future[str]) -> None:
    """Serve a project on this machine until cancelled.

    Args:
        project: The folder.
        port: 0: any that is free.
        ready: Set to the address once it answers.

    Raises:
        InputError: The port is taken.
    """
    try:
        sockets = bind_sockets(port, HERE)
    except OSError as error:
        raise InputError(
            f"port {port} cannot be used: {error.strerror}",
            where="--port",
            remedy="give another one, or 0 for any that is free",
        ) from error
    bench = Workbench(project)
    bench.attach()
    server = HTTPServer(application(bench), max_body_size=_LARGEST)
    server.add_sockets(sockets)
    try:
        _ = project.choices
        bench.look()
        ready.set_result(f"http://{HERE}:{sockets[0].getsockname()[1]}/")
        await asyncio.Event().wait()
    finally:
        server.stop()
        bench.worker.close()
