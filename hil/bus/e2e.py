"""End-to-end protection of messages: a checksum and a counter, by AUTOSAR's profiles.

| profile | header                              | counter  |
|---------|-------------------------------------|----------|
| P01     | CRC-8 (SAE J1850), 4-bit counter    | 0 to 14  |
| P02     | CRC-8 (polynomial 2F), 4-bit counter| 0 to 15  |
| P05     | CRC-16 (CCITT), 8-bit counter       | 0 to 255 |
| P11     | as P01, renamed for new systems     | 0 to 14  |

The header is at the start of the payload: the checksum, then the counter in the low bits of the
next byte. The message's data identifier enters the checksum and is not sent, so that a frame under
a wrong CAN identifier is refused.

Reference:
    AUTOSAR Foundation, *E2E Protocol Specification* (PRS_E2EProtocol), R21-11, chapters 6.3 (P01),
    6.4 (P02), 6.7 (P05), 6.9 (P11) and the examples there.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from e2e import p01, p02, p05, p11

from foundation.errors import BusError, UnknownNameError
from foundation.resumable import Resumable


class Status(Enum):
    """What a receiver makes of a frame; the first three carry good values."""

    OK = "ok"
    """The successor of the frame before."""
    INITIAL = "initial"
    """The first frame, with which nothing can be compared."""
    SOME_LOST = "some lost"
    """Good, but frames before it are missing."""
    REPEATED = "repeated"
    """The same counter again: a duplicate, or a sender that hangs."""
    WRONG_SEQUENCE = "wrong sequence"
    """More frames are missing than allowed, or an old one came late."""
    WRONG_CHECKSUM = "wrong checksum"
    """The payload is not what was sent, or was sent under another identifier."""

    @property
    def is_good(self) -> bool:
        """Whether the frame's values may be used."""
        return self in (Status.OK, Status.INITIAL, Status.SOME_LOST)


@dataclass(frozen=True)
class Profile:
    """A way to protect a payload.

    Attributes:
        name: AUTOSAR's.
        checksum_bits: Of the checksum, at the start of the payload.
        counter_bits: Of the counter that follows.
        modulus: How many values the counter takes.
        header: Bytes before the first signal.
    """

    name: str
    checksum_bits: int
    counter_bits: int
    modulus: int
    header: int


PROFILES = {
    profile.name: profile
    for profile in (
        Profile("P01", 8, 4, 15, 2),
        Profile("P02", 8, 4, 16, 2),
        Profile("P05", 16, 8, 256, 3),
        Profile("P11", 8, 4, 15, 2),
    )
}


@dataclass(frozen=True)
class Protection:
    """How one message is protected.

    Attributes:
        profile: Which profile.
        data_id: 16 bits that are the message's own; unused by P02.
        data_ids: P02's list of 16 bytes, one for each counter value.

    Raises:
        BusError: P02 without its list.

    Example:
        >>> frame = bytearray(8)
        >>> protection = Protection.of("P11", 0x123)
        >>> protection.protect(frame, counter=1)
        >>> frame.hex(), protection.is_intact(frame)
        ('9101000000000000', True)
    """

    profile: Profile
    data_id: int
    data_ids: bytes = b""

    def __post_init__(self) -> None:
        if self.profile.name == "P02" and len(self.data_ids) != 16:
            raise BusError(
                f"profile P02 has {len(self.data_ids)} data identifiers",
                remedy="give a list of 16 bytes: attribute E2EDataIDList, 32 hexadecimal digits",
            )

    @staticmethod
    def of(profile: str, data_id: int, data_ids: bytes = b"") -> Protection:
        """Return the protection by a profile's name.

        Raises:
            UnknownNameError: No such profile.
        """
        if profile not in PROFILES:
            raise UnknownNameError("E2E profile", profile, PROFILES)
        return Protection(PROFILES[profile], data_id, data_ids)

    def protect(self, payload: bytearray, counter: int) -> None:
        """Put counter and checksum into a payload.

        Args:
            payload: At least as long as the header; changed in place.
            counter: Smaller than the profile's modulus.
        """
        place = self.profile.checksum_bits // 8
        mask = (1 << self.profile.counter_bits) - 1
        payload[place] = payload[place] & ~mask & 0xFF | counter & mask
        match self.profile.name:
            case "P01":
                p01.e2e_p01_protect(payload, self.data_id, increment_counter=False)
            case "P02":
                p02.e2e_p02_protect(payload, self.data_ids, increment_counter=False)
            case "P05":
                p05.e2e_p05_protect(payload, self.data_id, increment_counter=False)
            case _:
                p11.e2e_p11_protect(payload, self.data_id, increment_counter=False)

    def is_intact(self, payload: bytes | bytearray) -> bool:
        """Whether the checksum is right."""
        if len(payload) < self.profile.header:
            return False
        data = bytearray(payload)  # three of the four want something that can be written to
        match self.profile.name:
            case "P01":
                return bool(p01.e2e_p01_check(data, self.data_id))
            case "P02":
                return bool(p02.e2e_p02_check(bytes(data), self.data_ids, length=len(data)))
            case "P05":
                return bool(p05.e2e_p05_check(bytes(data), self.data_id))
            case _:
                return bool(p11.e2e_p11_check(data, self.data_id))

    def counter(self, payload: bytes | bytearray) -> int:
        """Return the counter of a payload."""
        return payload[self.profile.checksum_bits // 8] & ((1 << self.profile.counter_bits) - 1)


class Counting:
    """The sender's side of a message: counts its frames and protects them."""

    def __init__(self, protection: Protection) -> None:
        self.protection = protection
        self._next = 0

    def protect(self, payload: bytearray) -> None:
        """Protect the next frame's payload, in place."""
        self.protection.protect(payload, self._next)
        self._next = (self._next + 1) % self.protection.profile.modulus


class Checking(Resumable):
    """The receiver's side of a message: is a frame intact, and the one that was to come?

    Args:
        protection: Of the message.
        most_lost: How many frames in a row may be missing.

    Attributes:
        lost: Frames that are known to be missing, by the counters of those that came.

    Example:
        >>> protection = Protection.of("P11", 0x123)
        >>> sender, receiver = Counting(protection), Checking(protection)
        >>> frames = [bytearray(8) for _ in range(4)]
        >>> for frame in frames:
        ...     sender.protect(frame)
        >>> [receiver.check(frames[k]).value for k in (0, 1, 1, 3)]
        ['initial', 'ok', 'repeated', 'some lost']
        >>> receiver.lost
        1
    """

    _changes = ("lost", "_last")

    def __init__(self, protection: Protection, *, most_lost: int = 4) -> None:
        self.protection = protection
        self.most_lost = most_lost
        self.lost = 0
        self._last: int | None = None

    def check(self, payload: bytes | bytearray) -> Status:
        """Return what to make of a frame's payload."""
        if not self.protection.is_intact(payload):
            return Status.WRONG_CHECKSUM
        counter = self.protection.counter(payload)
        if self._last is None:
            self._last = counter
            return Status.INITIAL
        ahead = (counter - self._last) % self.protection.profile.modulus
        if ahead == 0:
            return Status.REPEATED
        if ahead > self.protection.profile.modulus // 2:
            return Status.WRONG_SEQUENCE  # an old frame: the next ones are compared as before
        self._last = counter
        self.lost += ahead - 1
        if ahead == 1:
            return Status.OK
        return Status.SOME_LOST if ahead - 1 <= self.most_lost else Status.WRONG_SEQUENCE
