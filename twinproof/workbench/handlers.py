"""What the page asks for and sends: one handler an address."""

from __future__ import annotations

import json
import shutil
from collections.abc import Awaitable, Mapping
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from tornado import web
from tornado.escape import url_unescape

from foundation.errors import InputError, TwinproofError
from foundation.files import write_text
from twinproof.workbench import curves, mapping
from twinproof.workbench.bench import Workbench
from twinproof.workbench.project import Step
from twinproof.workbench.state import RESULTS, exports, state

HERE = "127.0.0.1"
STATIC = Path(__file__).parent / "static"
# Not imported from the report, whose packages take seconds.
_STYLE = Path(__file__).parents[1] / "report" / "templates" / "style.css"
# Not imported from the tasks, for the same reason.
TASKS = (*("look", "compare", "identify", "diagnose", "propose", "score", "improve", "export"),)


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

    def answer_state(self) -> None:
        """Answer with all that the page shows."""
        self.answer(state(self.bench.project, self.bench.job, looking=self.bench.looking))

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
        self.finish(_STYLE.read_bytes())


class Static(web.StaticFileHandler):
    """Scripts and styles."""

    def set_extra_headers(self, path: str) -> None:  # noqa: ARG002
        """Let a newer version be seen at once."""
        self.set_header("Cache-Control", "no-cache")


class State(Handler):
    """What there is, and changes of the form's fields."""

    def get(self) -> None:
        """Send the state."""
        self.answer_state()

    def patch(self) -> None:
        """Change fields; look at what was chosen."""
        self.bench.project.choose({name: str(text) for name, text in self.body().items()})
        self.bench.look()
        self.answer_state()


class Channel(Handler):
    """What is said of one channel, or of time."""

    def patch(self, name: str) -> None:
        """Change it."""
        said = {key: str(text) for key, text in self.body().items()}
        mapping.change_tables(self.bench.project.map_file, name, said)
        self.bench.look()
        self.answer_state()

    def delete(self, name: str) -> None:
        """Say nothing of it any more."""
        path = self.bench.project.map_file
        table: Mapping[str, Any] = mapping.read_tables(path).get("channels", {}).get(name, {})
        mapping.change_tables(path, name, dict.fromkeys(table, ""))
        self.bench.look()
        self.answer_state()


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
        if task not in TASKS:
            raise InputError(f"there is no task '{task}'", remedy="reload the page")
        self.bench.begin(task, {k: str(v) for k, v in asked.items()})
        self.answer_state()

    def delete(self) -> None:
        """End the running one."""
        self.bench.cancel()
        self.answer_state()


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
        self.answer_state()

    def delete(self) -> None:
        """Undo."""
        self.bench.project.undo()
        self.bench.look()
        self.answer_state()


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
        self.answer_state()


class Piece(Handler):
    """A result's piece of page."""

    def get(self, name: str) -> None:
        """Send it."""
        if name not in RESULTS:
            raise web.HTTPError(404)
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish(self.bench.project.page(name))


class _OfRecord(Handler):
    """Answers about the curves of one of the records compared."""

    def curves_folder(self) -> tuple[Path, dict[str, Any]]:
        """Return where they are, and what they are.

        Raises:
            HTTPError: There is no such record.
        """
        number = self.get_query_argument("record", "0")
        folder = self.bench.project.curves(int(number)) if number.isdecimal() else None
        about = None if folder is None else curves.about(folder)
        if folder is None or about is None:
            raise web.HTTPError(404)
        return folder, about


class Curves(_OfRecord):
    """Curves of a comparison, as few points as the page asks for."""

    def get(self) -> None:
        """Send numbers of 32 bit: time and curves, one after another, the time from its begin."""
        folder, _ = self.curves_folder()
        begin = float(self.get_query_argument("begin", "-inf"))
        end = float(self.get_query_argument("end", "inf"))
        points = min(max(int(self.get_query_argument("points", "4000")), 100), 200_000)
        time, values = curves.view(folder, begin, end, points)
        self.set_header("Content-Type", "application/octet-stream")
        # A float of 32 bit cannot hold the time of a long record to a millisecond.
        self.finish(time.tobytes() + b"".join(np.asarray(v, np.float32).tobytes() for v in values))


class About(_OfRecord):
    """What a comparison's curves are."""

    def get(self) -> None:
        """Send it."""
        folder, about = self.curves_folder()
        time = np.load(folder / "time.npy", mmap_mode="r")
        self.answer({**about, "begin": float(time[0]), "end": float(time[-1])})


class Download(Handler):
    """The project's results, to look at or to keep."""

    def get(self, path: str) -> None:
        """Send one of the files that the state lists."""
        if path not in exports(self.bench.project):
            raise web.HTTPError(404)
        found = self.bench.project.folder / path
        if found.suffix == ".html":
            self.set_header("Content-Type", "text/html; charset=utf-8")
            # A report's style is inside it.
        else:
            self.set_header("Content-Type", "application/octet-stream")
            self.set_header("Content-Disposition", f'attachment; filename="{found.name}"')
        self.finish(found.read_bytes())
