"""A twin's frames out of the stream, in order, each batch once, from a place on.

A push consumer's messages may be lost that are under way when a connection ends. The server numbers
what it delivers; where a number is missing, where the connection was made again, and where nothing
comes, the consumer is made anew behind the last batch that came.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field

from nats.aio.msg import Msg
from nats.aio.subscription import Subscription
from nats.js.api import AckPolicy, ConsumerConfig, DeliverPolicy
from nats.js.errors import NotFoundError

from foundation.errors import FormatError
from twin.jetstream.batch import Batch, unpacked
from twin.jetstream.connection import FAILURES, Connection

_LOG = logging.getLogger("twinproof.twin")
# What the server sends ahead of the check-point that makes it done with.
_AHEAD = 2000
# A consumer that nobody hears any more is removed by the server after this [s].
_FORGOTTEN = 600.0
# What was lost is found by its number, not by waiting: nothing is sent twice within this [s].
_NEVER = 86_400.0
_SILENT = 2.0
_AGAIN = 1.0


@dataclass(frozen=True)
class Place:
    """Where in which stream.

    Attributes:
        position: Number of the last message that is done with; 0: none is.
        stream: When the stream was made; one made anew begins with 1 again.
    """

    position: int = 0
    stream: str = ""


@dataclass(eq=False)
class _Delivery:
    """A consumer, as long as no message of it is missing."""

    begin: Place
    subscription: Subscription
    waiting: deque[Msg] = field(default_factory=deque[Msg])
    delivered: int = 0


class StreamedFrames:
    """Where a worker gets a twin's batches from. Nothing here waits for the server.

    Args:
        connection: To the stream.
        twin: Its name.
        generation: Of the claim; every claim has a consumer of its own.
        place: To begin behind.
    """

    def __init__(self, connection: Connection, twin: str, generation: int, place: Place) -> None:
        self._connection, self._twin = connection, twin
        self._durable, self._former = f"{twin}={generation}", f"{twin}={generation - 1}"
        self._place = place
        self._delivery: _Delivery | None = None
        self._last: Msg | None = None
        self._counts: Mapping[str, int] = {}
        self._faults: Mapping[str, str] = {}
        self._came = time.monotonic()
        self._renewed = connection.renewed
        self._next_look = 0.0
        self._opening: Future[_Delivery] | None = None
        self._open()

    @property
    def place(self) -> Place:
        """Behind the last batch that was read."""
        return self._place

    def read(self, most: int) -> Iterator[Batch]:
        """Yield the next batches, in order; `place` is behind the one that was yielded."""
        self._look()
        for _ in range(most):
            if self._delivery is None or not self._delivery.waiting:
                return
            batch = self._next(self._delivery)
            if batch is not None:
                yield batch

    def done(self) -> None:
        """Tell the server that everything read so far need not be sent again."""
        last, self._last = self._last, None
        if last is not None:
            self._connection.start(last.ack())

    def counts(self) -> Mapping[str, int]:
        """Return what the gateway has counted."""
        return self._counts

    def faults(self) -> dict[str, str]:
        """Return what fails at the gateway, and whether it is heard at all."""
        if time.monotonic() - self._came < _SILENT:
            return dict(self._faults)
        why = "no gateway publishes its frames"
        if not self._connection.is_up:
            why = "the NATS server is not reached"
        return {"stream": why}

    def close(self) -> None:
        """End it; the server forgets the consumer by itself."""
        delivery, self._delivery = self._delivery, None
        if self._opening is not None:
            self._opening.cancel()
        if delivery is not None:
            self._connection.start(_left(delivery.subscription))

    def _look(self) -> None:
        """Make the consumer anew where that is due; take it when it is made."""
        now, opening = time.monotonic(), self._opening
        if opening is not None:
            if not opening.done():
                return
            self._opening = None
            try:
                self._delivery = opening.result()
                self._place = self._delivery.begin
            except FAILURES as error:
                _LOG.info("no consumer yet", extra={"twin": self._twin, "because": str(error)})
            self._next_look = now + _AGAIN
        renewed = self._connection.renewed
        torn = self._delivery is None or renewed != self._renewed
        if (torn or now - self._came > _SILENT) and now >= self._next_look:
            if self._delivery is not None and self._delivery.waiting and not torn:
                return
            self._renewed = renewed
            self._open()

    def _open(self) -> None:
        former, self._delivery = self._delivery, None
        self._opening = self._connection.start(self._opened(former, self._place))

    async def _opened(self, former: _Delivery | None, place: Place) -> _Delivery:
        connection, js = self._connection, self._connection.jetstream()
        if former is not None:
            await _left(former.subscription)
        state = await connection.state()
        made = "" if state.created is None else state.created.isoformat()
        if made != place.stream:
            place = Place(0, made)
        for durable in (self._former, self._durable):
            try:
                await js.delete_consumer(connection.stream, durable)
            except NotFoundError:
                continue
        inbox = connection.client.new_inbox()
        waiting: deque[Msg] = deque()

        async def came(message: Msg) -> None:
            waiting.append(message)

        subscription = await connection.client.subscribe(inbox, cb=came)
        config = ConsumerConfig(
            durable_name=self._durable,
            deliver_subject=inbox,
            filter_subject=connection.frames_of(self._twin),
            deliver_policy=DeliverPolicy.BY_START_SEQUENCE,
            opt_start_seq=place.position + 1,
            ack_policy=AckPolicy.ALL,
            ack_wait=_NEVER,
            max_ack_pending=_AHEAD,
            inactive_threshold=_FORGOTTEN,
        )
        try:
            await js.add_consumer(connection.stream, config)
        except BaseException:
            await _left(subscription)
            raise
        return _Delivery(place, subscription, waiting)

    def _next(self, delivery: _Delivery) -> Batch | None:
        message = delivery.waiting.popleft()
        sequence = message.metadata.sequence
        if sequence.consumer != delivery.delivered + 1:
            self._next_look = 0.0
            self._open()
            return None
        delivery.delivered = sequence.consumer
        if sequence.stream <= self._place.position:
            return None
        self._place = Place(sequence.stream, self._place.stream)
        self._last, self._came = message, time.monotonic()
        try:
            batch = unpacked(message.data)
        except FormatError as error:
            _LOG.error("a message was left out", extra={"twin": self._twin, "because": str(error)})
            return None
        self._counts, self._faults = batch.counts, batch.faults
        return batch


async def _left(subscription: Subscription) -> None:
    try:
        await subscription.unsubscribe()
    except FAILURES:
        return  # it went with its connection
