"""The server: one page, the project's files, and the worker, for one user on this machine."""

from __future__ import annotations

import asyncio

from tornado import web
from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets

from foundation.errors import InputError
from twinproof.workbench import handlers
from twinproof.workbench.bench import Workbench
from twinproof.workbench.handlers import HERE, STATIC
from twinproof.workbench.project import Project

_LARGEST_UPLOAD = 64 * 2**30


def application(bench: Workbench) -> web.Application:
    """Return the web application."""
    given = {"bench": bench}
    return web.Application(
        [
            (r"/", handlers.Page, given),
            (r"/report.css", handlers.Style, given),
            (r"/static/(.*)", handlers.Static, {"path": str(STATIC)}),
            (r"/api/state", handlers.State, given),
            (r"/api/channels/(.+)", handlers.Channel, given),
            (r"/upload/(recordings|models)/([^/]+)", handlers.Upload, given),
            (r"/api/jobs", handlers.Jobs, given),
            (r"/api/steps", handlers.Steps, given),
            (r"/api/demo", handlers.Demo, given),
            (r"/api/pieces/(\w+)", handlers.Piece, given),
            (r"/api/curves", handlers.Curves, given),
            (r"/api/about", handlers.About, given),
            (r"/files/(.+)", handlers.Download, given),
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
    bench = Workbench(project, asyncio.get_running_loop())
    server = HTTPServer(application(bench), max_body_size=_LARGEST_UPLOAD)
    server.add_sockets(sockets)
    try:
        _ = project.choices
        bench.look()
        ready.set_result(f"http://{HERE}:{sockets[0].getsockname()[1]}/")
        await asyncio.Event().wait()
    finally:
        server.stop()
        bench.worker.close()
