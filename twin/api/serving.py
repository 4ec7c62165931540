"""Serve the API until the process is told to end."""

from __future__ import annotations

import logging
import signal
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import uvicorn
from fastapi import FastAPI

from foundation.errors import InputError, TwinproofError
from twin.api.app import make_app
from twin.service import Service
from twin.settings import Settings
from twin.tokens import Tokens, read_tokens

_LOG = logging.getLogger("twinproof.twin")
_FAREWELL = 5


def tokens_of(settings: Settings) -> Tokens:
    """Return the tokens that the settings name.

    Raises:
        InputError: The service would listen to other machines without tokens.
    """
    service = settings.service
    tokens = read_tokens(settings.file(service.tokens)) if service.tokens else Tokens()
    if not tokens and not service.is_loopback:
        raise InputError(
            f"without tokens nobody but this machine may ask, and not at {service.listen}",
            where=f"{settings.path}, service.listen",
            remedy="listen at 127.0.0.1, or make tokens with `twinproof twin token NAME` and "
            "name their file: service.tokens",
        )
    return tokens


class Server(uvicorn.Server):
    """Ends live streams first: a server waits for its readers."""

    def __init__(self, config: uvicorn.Config, service: Service) -> None:
        super().__init__(config)
        self._service = service

    @property
    def url(self) -> str:
        """Where it listens, once it has started."""
        host, port = self.servers[0].sockets[0].getsockname()[:2]
        return f"http://{host}:{port}"

    def end(self) -> None:
        """End all streams, and take no more."""
        self._service.hub.close()
        self.should_exit = True

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:  # noqa: ARG002 - uvicorn's
        """End when told to by a signal, at once if told twice."""
        # Not as uvicorn does it: that raises the signal again when it has ended, before we have.
        self.force_exit = self.should_exit and sig == signal.SIGINT
        self.end()


def _server(app: FastAPI, host: str, port: int) -> Server:
    config = uvicorn.Config(
        app,
        host,
        port,
        log_config=None,
        access_log=False,
        # A service begins and ends with its command, not with its server.
        lifespan="off",
        timeout_graceful_shutdown=_FAREWELL,
        server_header=False,
    )
    return Server(config, app.state.service)


@contextmanager
def served(app: FastAPI) -> Generator[Server]:
    """Serve an API beside something else: in a thread, to this machine, on a free port.

    Args:
        app: Of a service that has been started.
    """
    server = _server(app, "127.0.0.1", 0)
    thread = threading.Thread(target=server.run, name="server", daemon=True)
    thread.start()
    while not server.started and thread.is_alive():
        time.sleep(0.01)
    try:
        yield server
    finally:
        server.end()
        thread.join()


def serve(service: Service) -> None:
    """Start a service and serve it until SIGINT or SIGTERM; SIGHUP reads the settings again.

    Raises:
        InputError: Somebody listens there already, or tokens are missing.
    """
    app = make_app(service, tokens_of(service.settings))
    host, port = service.settings.service.address
    server = _server(app, host, port)
    if hasattr(signal, "SIGHUP") and threading.current_thread() is threading.main_thread():

        def reload(_signal: int, _frame: FrameType | None) -> None:
            _reload_apart(service)

        signal.signal(signal.SIGHUP, reload)
    try:
        socket = server.config.bind_socket()
    except SystemExit as error:
        raise InputError(
            f"{host}:{port} cannot be listened at: it is taken, or not of this machine",
            where=f"{service.settings.path}, service.listen",
            remedy="end the other service, or choose another port",
        ) from error
    service.start()
    _LOG.info("listening", extra={"address": f"{host}:{socket.getsockname()[1]}"})
    with socket:
        server.run([socket])


def _reload_apart(service: Service) -> None:
    """Reload in a thread: a signal may come while this one holds a lock."""

    def reload() -> Any:
        try:
            _LOG.info("reloaded", extra=dict(service.reload()))
        except TwinproofError as error:
            _LOG.error("not reloaded", extra={"because": str(error)})

    threading.Thread(target=reload, name="reload").start()
