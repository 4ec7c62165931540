"""A NATS server of the tests' own, which can be killed and started again."""

from __future__ import annotations

import asyncio
import shutil
import signal
import socket
import subprocess
import time

import nats

PROGRAM = shutil.which("nats-server")


class Server:
    """`nats-server` with JetStream in a folder."""

    process: subprocess.Popen[bytes]

    def __init__(self, folder, *, jetstream=True):
        self.folder, self.jetstream = folder, jetstream
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.url = f"nats://127.0.0.1:{self.port}"

    def start(self):
        options = ["-js", "-sd", str(self.folder / "store")] if self.jetstream else []
        with (self.folder / "nats.log").open("ab") as log:
            self.process = subprocess.Popen(
                [PROGRAM, "-a", "127.0.0.1", "-p", str(self.port), *options], stdout=log, stderr=log
            )
        end = time.monotonic() + 20
        while time.monotonic() < end:
            try:
                socket.create_connection(("127.0.0.1", self.port), 1).close()
            except OSError:
                time.sleep(0.02)
            else:
                return
        raise RuntimeError("the NATS server does not start")

    def stop(self, how=signal.SIGTERM):
        self.process.send_signal(how)
        self.process.wait(20)

    def do(self, work):
        """Run `work(jetstream)` against it."""

        async def done():
            client = await nats.connect(self.url)
            try:
                return await work(client.jetstream())
            finally:
                await client.close()

        return asyncio.run(done())
