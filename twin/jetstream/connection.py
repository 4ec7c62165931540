"""A connection to NATS JetStream for threads: its event loop runs in one of its own."""

from __future__ import annotations

import asyncio
import concurrent.futures
import logging
import os
import platform
import threading
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, TypeVar

import nats
from nats.aio.client import Client
from nats.aio.msg import Msg
from nats.aio.subscription import Subscription
from nats.errors import Error as NatsError
from nats.js import JetStreamContext
from nats.js.api import DiscardPolicy, RetentionPolicy, StorageType, StreamConfig, StreamInfo
from nats.js.errors import APIError, NotFoundError, ServiceUnavailableError

from foundation.closing import Closing
from foundation.errors import InputError
from twin.settings import Settings

T = TypeVar("T")
_LOG = logging.getLogger("twinproof.twin")
PATIENCE = 5.0
"""How long a server may take to answer [s]."""
_AGAIN = 0.25
# A batch that is published a second time within this is dropped by the server [s].
_DUPLICATES = 120.0
_CHANGING = ("max_age", "max_bytes", "num_replicas")
_NO_ROOM = (10023, 10047)
"""The server's codes for a stream that is larger than it may be."""
FAILURES = (NatsError, OSError, asyncio.TimeoutError)
"""What a connection that fails raises."""


def process_name() -> str:
    """Return a name of this process among all machines."""
    return f"{platform.node() or 'machine'}-{os.getpid()}"


class StreamError(InputError):
    """JetStream is not there, or cannot hold what is asked."""


class Connection(Closing):
    """JetStream, and the stream of one file of settings. Any thread may use it.

    A connection that is lost is made again by itself, for as long as it takes.

    Args:
        settings: `[jetstream]` of them.
        name: Of this process, as the server lists it.

    Attributes:
        client: Only for coroutines that are given to `run` or `start`.
        renewed: How often the connection was made again.

    Raises:
        StreamError: There is no server, no JetStream, or no room for the stream.
    """

    def __init__(self, settings: Settings, name: str) -> None:
        self._settings, self._stream = settings, settings.stream
        self._name = name
        self._where = f"{settings.path}, jetstream.url"
        if not self._stream.url:
            raise StreamError(
                "there is no stream between gateways and workers",
                where=self._where,
                remedy='write [jetstream] with url = "nats://host:4222", or use `twin serve`',
            )
        self.renewed = 0
        self._begun = False
        self.client = Client()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="nats", daemon=True)
        self._thread.start()
        try:
            self.run(self._connect())
        except BaseException:
            self.close()
            raise

    @property
    def is_up(self) -> bool:
        """Whether the server is connected now."""
        return self.client.is_connected

    @property
    def stream(self) -> str:
        """Name of the stream."""
        return self._stream.name

    def frames_of(self, twin: str) -> str:
        """Return the subject of a twin's frames."""
        return f"{self._stream.name}.frames.{twin}"

    def question_to(self, twin: str) -> str:
        """Return the subject of questions to the worker that runs a twin."""
        return f"{self._stream.name}.ask.{twin}"

    def jetstream(self) -> JetStreamContext:
        """Return what coroutines publish with."""
        return self.client.jetstream(timeout=PATIENCE)

    def run(self, work: Coroutine[Any, Any, T], patience: float = 4 * PATIENCE) -> T:
        """Have a coroutine run, and return what it returns.

        Raises:
            StreamError: It did not end in time.
        """
        future = asyncio.run_coroutine_threadsafe(work, self._loop)
        try:
            return future.result(patience)
        except concurrent.futures.TimeoutError as error:
            future.cancel()
            raise self._silent() from error

    def start(self, work: Coroutine[Any, Any, T]) -> concurrent.futures.Future[T]:
        """Have a coroutine run; whoever wants it to end cancels it."""
        return asyncio.run_coroutine_threadsafe(work, self._loop)

    def answer(
        self, subject: str, reply: Callable[[bytes], bytes | None]
    ) -> concurrent.futures.Future[Subscription]:
        """Answer what is asked on a subject, until the subscription ends."""

        async def answered(message: Msg) -> None:
            # What answers looks into a database: not in the loop.
            found = await asyncio.to_thread(reply, message.data)
            if found is not None:
                await message.respond(found)

        return self.start(self.client.subscribe(subject, cb=_quietly(answered)))

    async def asked(self, subject: str, question: bytes, patience: float) -> bytes | None:
        """Return what is answered on a subject; None: nobody does, or not in time [s]."""
        try:
            return (await self.client.request(subject, question, timeout=patience)).data
        except FAILURES:
            return None

    def end(self, answers: concurrent.futures.Future[Subscription]) -> None:
        """Answer no more."""

        async def ended() -> None:
            await (await asyncio.wrap_future(answers)).unsubscribe()

        self.start(ended())

    async def state(self) -> StreamInfo:
        """Return what the stream holds."""
        return await self.jetstream().stream_info(self._stream.name)

    def close(self) -> None:
        """End it."""
        if self._loop.is_closed():
            return
        try:
            if self._begun:
                self.run(self.client.close(), PATIENCE)
        except (*FAILURES, StreamError) as error:
            _LOG.warning("the connection to the stream did not end", extra={"because": str(error)})
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(PATIENCE)
        if not self._thread.is_alive():
            self._loop.close()

    async def _connect(self) -> None:
        options: dict[str, Any] = {}
        if self._stream.credentials:
            options["user_credentials"] = str(self._settings.file(self._stream.credentials))

        said: list[str] = []

        async def failed(error: Exception) -> None:
            said[:] = [str(error) or type(error).__name__]
            _LOG.debug("the stream's connection", extra={"because": repr(error)})

        async def lost() -> None:
            if not self.client.is_closed:
                _LOG.warning("the NATS server is gone", extra={"url": self._stream.url})

        async def renewed() -> None:
            self.renewed += 1
            _LOG.info("the NATS server is back", extra={"url": self._stream.url})

        servers = [url.strip() for url in self._stream.url.split(",")]
        # Once by itself, to learn why it cannot be; then for as long as it takes.
        try:
            probe = await nats.connect(
                servers,
                connect_timeout=2,
                allow_reconnect=False,
                max_reconnect_attempts=1,
                reconnect_time_wait=_AGAIN,  # pyright: ignore[reportArgumentType] - seconds, of any kind
                error_cb=failed,
                **options,
            )
            await probe.close()
            self._begun = True
            await self.client.connect(
                servers,
                name=self._name,
                error_cb=failed,
                disconnected_cb=lost,
                reconnected_cb=renewed,
                max_reconnect_attempts=-1,
                reconnect_time_wait=_AGAIN,  # pyright: ignore[reportArgumentType] - seconds, of any kind
                ping_interval=2,
                **options,
            )
        except (*FAILURES, ValueError) as error:
            because = said[0] if said else str(error) or type(error).__name__
            raise StreamError(
                f"the NATS server cannot be reached: {because}",
                where=f"{self._where} = {self._stream.url}",
                remedy="start it (`nats-server -js -sd FOLDER`), or correct url and credentials",
            ) from error
        await self._make_stream()

    async def _make_stream(self) -> None:
        s, js = self._stream, self.jetstream()
        subjects = [f"{s.name}.frames.*"]
        wanted = StreamConfig(
            name=s.name,
            subjects=subjects,
            retention=RetentionPolicy.LIMITS,
            storage=StorageType.FILE,
            discard=DiscardPolicy.OLD,
            max_age=s.age,
            max_bytes=round(s.limit),
            num_replicas=s.replicas,
            duplicate_window=min(_DUPLICATES, s.age),
        )
        try:
            try:
                there = (await js.stream_info(s.name)).config
            except NotFoundError:
                await js.add_stream(wanted)
                return
            if there.subjects != subjects:
                raise StreamError(
                    f"the stream '{s.name}' is somebody else's: its subjects are {there.subjects}",
                    where=self._where,
                    remedy="give it another name: jetstream.name",
                )
            if any(getattr(there, n) != getattr(wanted, n) for n in _CHANGING):
                await js.update_stream(wanted)
        except ServiceUnavailableError as error:
            raise StreamError(
                "the NATS server runs without JetStream",
                where=f"{self._where} = {s.url}",
                remedy="start it with `nats-server -js -sd FOLDER`",
            ) from error
        except APIError as error:
            smaller = error.err_code in _NO_ROOM
            raise StreamError(
                f"the server does not make the stream '{s.name}': {error.description}",
                where=f"{self._where} = {s.url}",
                remedy=f"lower jetstream.limit, now {s.limit:g} bytes, or give the server more room"
                if smaller
                else "see the server's log and the rights of its user",
            ) from error
        except FAILURES as error:
            raise self._silent() from error

    def _silent(self) -> StreamError:
        return StreamError(
            "the NATS server does not answer",
            where=f"{self._where} = {self._stream.url}",
            remedy="see that it runs; what waits is kept meanwhile",
        )


def _quietly(work: Callable[[Msg], Awaitable[None]]) -> Callable[[Msg], Awaitable[None]]:
    async def done(message: Msg) -> None:
        try:
            await work(message)
        except Exception:
            # A question that cannot be answered is not: who asks takes that for a no.
            _LOG.exception("a question was not answered")

    return done
