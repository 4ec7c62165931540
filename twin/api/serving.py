"""Serve the API until the process is told to end."""

from __future__ import annotations

import logging
import signal
import threading
from types import FrameType
from typing import Any

import uvicorn

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


class _Server(uvicorn.Server):
    """Ends live streams first: a server waits for its readers."""

    def __init__(self, config: uvicorn.Config, service: Service) -> None:
        super().__init__(config)
        self._service = service

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:  # noqa: ARG002 - uvicorn's
        self._service.hub.close()
        # Not as uvicorn does it: that raises the signal again when it has ended, before we have.
        self.force_exit = self.should_exit and sig == signal.SIGINT
        self.should_exit = True


def serve(service: Service) -> None:
    """Start a service and serve it until SIGINT or SIGTERM; SIGHUP reads the settings again.

    Raises:
        InputError: Somebody listens there already, or tokens are missing.
    """
    app = make_app(service, tokens_of(service.settings))
    host, port = service.settings.service.address
    config = uvicorn.Config(
        app,
        host,
        port,
        log_config=None,
        access_log=False,
        timeout_graceful_shutdown=_FAREWELL,
        server_header=False,
    )
    server = _Server(config, service)
    if hasattr(signal, "SIGHUP") and threading.current_thread() is threading.main_thread():

        def reload(_signal: int, _frame: FrameType | None) -> None:
            _reload_apart(service)

        signal.signal(signal.SIGHUP, reload)
    try:
        socket = config.bind_socket()
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
