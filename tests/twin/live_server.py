"""A real server on a free port of this machine."""

import threading
import time
from contextlib import contextmanager

import uvicorn


class Server(uvicorn.Server):
    def service_gone(self):
        """End all streams and take no more."""
        self.config.app.state.service.hub.close()
        self.should_exit = True


@contextmanager
def served(app):
    config = uvicorn.Config(
        app, port=0, log_config=None, lifespan="off", timeout_graceful_shutdown=2
    )
    server = Server(config)
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    port = server.servers[0].sockets[0].getsockname()[1]
    try:
        yield f"http://127.0.0.1:{port}", server
    finally:
        server.service_gone()
        thread.join()
