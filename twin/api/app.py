"""The API's routes."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Body, Depends, FastAPI, Query, Request, Response
from fastapi.responses import FileResponse, JSONResponse, PlainTextResponse, StreamingResponse
from fastapi.staticfiles import StaticFiles
from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Send
from starlette.types import Scope as Connection

from foundation.errors import InputError, StoreError, UnknownNameError
from twin.api import documents as docs
from twin.api.access import Approver, Operator, Requires, refuse_foreign_hosts
from twin.api.metrics import exposition
from twin.events import EventKind
from twin.hub import FLEET
from twin.service import Service
from twin.tokens import Scope, Tokens

PAGES = Path(__file__).parents[1] / "pages"
# Everything of a page is from here: whatever somebody smuggles in is not run.
_POLICY = "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
_BIGGEST = 2**53


def _service(request: Request) -> Service:
    return request.app.state.service


Asked = Annotated[Service, Depends(_service)]
_OPEN = APIRouter()
_READING = APIRouter(dependencies=[Depends(Requires(Scope.READ))])

Answers = dict[int | str, dict[str, Any]]
_REFUSED: Answers = {code: {"model": docs.Problem} for code in (401, 403, 404, 409, 503)}
_ASKED: Answers = {code: {"model": docs.Problem} for code in (401, 403, 404, 503)}

Time = Annotated[float, Query(ge=-1e12, le=1e12, allow_inf_nan=False)]
Number = Annotated[int | None, Query(ge=0, le=_BIGGEST)]
Limit = Annotated[int, Query(ge=1, le=1000)]


@_OPEN.get("/healthz", tags=["service"], responses={503: {"model": docs.Health}})
def healthz(service: Asked, response: Response) -> docs.Health:
    """Whether the process lives: its twins are being fed."""
    response.status_code = 200 if service.is_alive else 503
    return docs.Health(ok=service.is_alive, faults={})


@_OPEN.get("/readyz", tags=["service"], responses={503: {"model": docs.Health}})
def readyz(service: Asked, response: Response) -> docs.Health:
    """Whether it can do its work: nothing fails."""
    faults = service.faults
    ready = service.is_alive and not faults
    response.status_code = 200 if ready else 503
    # Names only, no reasons: who asks need not show a token.
    return docs.Health(ok=ready, faults=dict.fromkeys(faults, "fails"))


@_READING.get("/metrics", tags=["service"], responses=_ASKED)
def metrics(service: Asked) -> PlainTextResponse:
    """For Prometheus."""
    text, kind = exposition(service)
    return PlainTextResponse(text, media_type=kind)


@_READING.get("/gate", tags=["gate"], responses=_ASKED)
def gate(
    service: Asked,
    twin: Annotated[str, Query(min_length=1, max_length=200)],
    controller: Annotated[str, Query(pattern=r"^[0-9a-f]{64}$")],
) -> docs.Gate:
    """May the controller with this hash be deployed on this twin's plant now?"""
    return docs.Gate(**service.decide(twin, controller))


@_READING.get("/twins", tags=["twins"], responses=_ASKED)
def twins(service: Asked) -> docs.Fleet:
    """All twins in brief."""
    return docs.Fleet.model_validate({"twins": service.fleet()})


@_READING.get("/twins/{twin}", tags=["twins"], responses=_ASKED)
def twin_view(service: Asked, twin: str) -> docs.TwinView:
    """A twin in full."""
    return docs.TwinView.model_validate(service.view(twin))


@_READING.get("/live", tags=["live"], responses=_ASKED)
async def live_fleet(service: Asked) -> StreamingResponse:
    """All twins in brief, as server-sent events."""
    return _stream(service.hub.stream(FLEET))


@_READING.get("/twins/{twin}/live", tags=["live"], responses=_ASKED)
async def live(service: Asked, twin: str) -> StreamingResponse:
    """A twin in full, five times a second, as server-sent events."""
    service.monitor(twin)
    return _stream(service.hub.stream(twin))


@_READING.get("/events", tags=["events"], responses=_ASKED)
def events(
    service: Asked,
    twin: Annotated[str | None, Query(max_length=200)] = None,
    kind: EventKind | None = None,
    before: Number = None,
    limit: Limit = 100,
) -> docs.Events:
    """The event log, newest first."""
    found = service.store.events(twin=twin, kind=kind, before=before, limit=limit)
    return docs.Events.model_validate({"events": [e.document() for e in found]})


@_READING.get("/audit", tags=["events"], responses=_ASKED)
def audit(service: Asked) -> docs.AuditResult:
    """Whether the event log is whole."""
    return docs.AuditResult(**vars(service.store.audit()))


@_READING.get("/twins/{twin}/parameters", tags=["twins"], responses=_ASKED)
def parameters(service: Asked, twin: str, limit: Limit = 100) -> docs.Sets:
    """Parameter sets and what became of them, newest first."""
    service.known(twin)
    return docs.Sets(sets=service.store.parameter_sets(twin, limit))


@_READING.get("/twins/{twin}/history", tags=["twins"], responses=_ASKED)
def history(
    service: Asked,
    twin: str,
    name: Annotated[str, Query(min_length=1, max_length=200)],
    start: Time = 0.0,
    end: Time = 1e12,
) -> docs.History:
    """A parameter, or with `.sd` its standard deviation, over time."""
    service.known(twin)
    spans = service.store.history(twin, name, start, end)
    return docs.History.model_validate({"spans": [vars(s) for s in spans]})


@_READING.get("/evidence/{evidence}", tags=["gate"], responses=_ASKED)
def evidence(service: Asked, evidence: str) -> docs.EvidenceDocument:
    """What a verification found."""
    found = service.store.evidence(evidence)
    return docs.EvidenceDocument(id=found.id, evidence=found.document())


@_READING.get("/lineage/{artifact}", tags=["gate"], responses=_ASKED)
def lineage(service: Asked, artifact: str) -> docs.Lineage:
    """What an approval, a study, parameters were made from, back to the recording."""
    return docs.Lineage(artifacts=service.store.lineage(artifact))


@_OPEN.post("/twins/{twin}/verify", tags=["operate"], status_code=202, responses=_REFUSED)
def verify(service: Asked, twin: str, token: Operator) -> docs.Happened:
    """Have the plant verified now."""
    service.monitor(twin).ask_for_verification(token.name)
    return docs.Happened(events=[])


@_OPEN.post("/reload", tags=["operate"], responses=_REFUSED)
def reload(service: Asked, _: Operator) -> docs.Reloaded:
    """Read the settings again."""
    return docs.Reloaded(**service.reload())


@_OPEN.post("/twins/{twin}/approve", tags=["approve"], responses=_REFUSED)
def approve(
    service: Asked, twin: str, token: Approver, wanted: Annotated[docs.Approve, Body()]
) -> docs.Happened:
    """Put parameters that passed their verification into force."""
    found = service.monitor(twin).approve(wanted.parameters, token.name)
    return docs.Happened(events=[e.document() for e in found])


@_OPEN.post("/twins/{twin}/rollback", tags=["approve"], responses=_REFUSED)
def rollback(service: Asked, twin: str, token: Approver) -> docs.Happened:
    """Put the parameters that were in force before into force again."""
    found = service.monitor(twin).roll_back(token.name)
    return docs.Happened(events=[e.document() for e in found])


def make_app(service: Service, tokens: Tokens) -> FastAPI:
    """Return the API of a service.

    Args:
        service: Started.
        tokens: Who may ask what; none: reading only.
    """
    app = FastAPI(
        title="twinproof twin service",
        version=version("twinproof"),
        description="Live twins of plants, their drift, and whether a controller may be deployed.",
        docs_url=None,  # its page would load scripts from elsewhere
        redoc_url=None,
    )
    app.state.service, app.state.tokens = service, tokens
    _errors(app)
    app.add_middleware(_Guard, tokens=tokens)
    app.include_router(_OPEN)
    app.include_router(_READING)
    for path, file in (
        ("/", "fleet.html"),
        ("/pages/twin", "twin.html"),
        ("/pages/events", "events.html"),
    ):
        _page(app, path, PAGES / file)
    app.mount("/static", StaticFiles(directory=PAGES / "static"), name="static")
    return app


def _page(app: FastAPI, path: str, file: Path) -> None:
    async def page() -> FileResponse:
        return FileResponse(file)

    app.add_api_route(path, page, include_in_schema=False)


def _stream(events: Any) -> StreamingResponse:
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(events, media_type="text/event-stream", headers=headers)


def _errors(app: FastAPI) -> None:
    def answer(status: int) -> Callable[[Request, Exception], JSONResponse]:
        return lambda _, error: JSONResponse({"detail": str(error)}, status)

    app.add_exception_handler(UnknownNameError, answer(404))
    app.add_exception_handler(StoreError, answer(503))
    app.add_exception_handler(InputError, answer(409))


class _Guard:
    """Refuses requests before anything else, and adds headers to answers.

    A middleware of ASGI's own kind: Starlette's other one hands every piece of a live stream from
    task to task.
    """

    def __init__(self, app: ASGIApp, tokens: Tokens) -> None:
        self._app, self._tokens = app, tokens

    async def __call__(self, scope: Connection, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = Request(scope)
        refused = refuse_foreign_hosts(request, self._tokens)
        if refused:
            await JSONResponse({"detail": refused}, 403)(scope, receive, send)
            return
        if int(request.headers.get("content-length") or 0) > 1 << 16:
            await JSONResponse({"detail": "that is too much"}, 413)(scope, receive, send)
            return

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["Content-Security-Policy"] = _POLICY
                headers["X-Content-Type-Options"] = "nosniff"
            await send(message)

        await self._app(scope, receive, guarded)
