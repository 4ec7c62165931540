"""The event log as a chain: each entry's code covers the entry and the code before it.

The codes are HMAC-SHA-256 (RFC 2104) with a key that is kept outside the database, so that nobody
who can only write to the database can change, insert, reorder or remove an entry unseen. What a
chain alone cannot show is that its end was cut off; so the newest code is kept beside the key too.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import secrets
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foundation.errors import FormatError, InputError
from foundation.files import write_text

START = "0" * 64
"""In place of the code before the first entry."""


def canonical(value: Any) -> str:
    """Return JSON in the one form that is hashed: sorted keys, no blanks, shortest exact numbers.

    Raises:
        ValueError: A number that JSON has not (NaN, infinite).

    Example:
        >>> canonical({"b": 1.0, "a": [True, None]})
        '{"a":[true,null],"b":1.0}'
    """
    return json.dumps(
        value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )


def content_hash(value: Any) -> str:
    """Return the SHA-256 of a JSON value in its canonical form."""
    return hashlib.sha256(canonical(value).encode()).hexdigest()


@dataclass(frozen=True)
class Entry:
    """An event as it is kept.

    Attributes:
        number: 1, 2, 3, … without gaps.
        time: Of the data that told it [s].
        logged: When it was written [s].
        twin, kind: As in `Event`.
        detail: Canonical JSON.
        code: HMAC of all of this and of the code before.
    """

    number: int
    time: float
    logged: float
    twin: str
    kind: str
    detail: str
    code: str = ""

    def document(self) -> dict[str, Any]:
        """Return the entry as JSON."""
        return {
            "number": self.number,
            "time": self.time,
            "logged": self.logged,
            "twin": self.twin,
            "kind": self.kind,
            "detail": json.loads(self.detail),
        }


@dataclass(frozen=True)
class Head:
    """The newest entry: its number and its code."""

    number: int = 0
    code: str = START


@dataclass(frozen=True)
class Audit:
    """Whether a log is whole.

    Attributes:
        events: How many entries were read.
        intact: Whether nothing is wrong.
        because: What is wrong, and at which entry; empty if nothing is.
    """

    events: int
    intact: bool
    because: str = ""


def code(key: bytes, entry: Entry, previous: str) -> str:
    """Return an entry's code, given the code before it.

    Example:
        >>> entry = Entry(1, 0.0, 0.0, "robot", "started", "{}")
        >>> code(b"key", entry, START) == code(b"other key", entry, START)
        False
    """
    message = canonical(
        [entry.number, entry.time, entry.logged, entry.twin, entry.kind, entry.detail, previous]
    )
    return hmac.new(key, message.encode(), hashlib.sha256).hexdigest()


def check(entries: Iterable[Entry], key: bytes, anchor: Head) -> Audit:
    """Return whether a log is whole.

    Args:
        entries: All of it, by number.
        key: That the codes were made with.
        anchor: The newest entry that is known from outside the database. The log may go on after
            it: an entry is there a moment before its code is outside.

    Example:
        >>> check([], b"key", Head())
        Audit(events=0, intact=True, because='')
    """
    head, reached = Head(), anchor == Head()
    for entry in entries:
        if entry.number != head.number + 1:
            return Audit(head.number, False, f"after entry {head.number} comes {entry.number}")
        if not hmac.compare_digest(code(key, entry, head.code), entry.code):
            return Audit(head.number, False, f"entry {entry.number} is not what was written")
        head = Head(entry.number, entry.code)
        reached = reached or head == anchor
    if not reached:
        return Audit(
            head.number, False, f"entries up to {anchor.number} were written, and are not there"
        )
    return Audit(head.number, True)


def sealed(key: bytes, about: str, content: bytes) -> bytes:
    """Return content with a code before it, for a place that others can write to.

    Example:
        >>> unsealed(b"key", "a", sealed(b"key", "a", b"content"))
        b'content'
        >>> unsealed(b"key", "b", sealed(b"key", "a", b"content"))
    """
    return _seal(key, about, content) + content


def unsealed(key: bytes, about: str, found: bytes) -> bytes | None:
    """Return what was sealed; None: it was with another key, about something else, or changed."""
    code, content = found[: hashlib.sha256().digest_size], found[hashlib.sha256().digest_size :]
    return content if hmac.compare_digest(_seal(key, about, content), code) else None


def _seal(key: bytes, about: str, content: bytes) -> bytes:
    # Not to be taken for the code of an entry, which is of a JSON list.
    return hmac.new(key, b"sealed\0" + about.encode() + b"\0" + content, hashlib.sha256).digest()


@dataclass(frozen=True)
class KeyFile:
    """The key of the log, and beside it (`.head`) the newest code.

    Attributes:
        path: Of the key. It belongs to the service's user, readable by nobody else.
    """

    path: Path

    @property
    def anchor_path(self) -> Path:
        """Where the newest code is kept."""
        return self.path.with_name(f"{self.path.name}.head")

    def key(self, *, make: bool = False) -> bytes:
        """Return the key.

        Args:
            make: Make one if there is none.

        Raises:
            InputError: There is none, or it cannot be read.
            FormatError: It is too short to be one.
        """
        if make and not self.path.exists():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(handle, "w") as file:
                file.write(secrets.token_hex(32) + "\n")
                file.flush()
                os.fsync(file.fileno())
        try:
            text = self.path.read_text(encoding="ascii", errors="replace").strip()
        except OSError as error:
            raise InputError(
                f"the log's key cannot be read: {error.strerror}",
                where=str(self.path),
                remedy="run as the service's user, or name the file: service.key",
            ) from error
        if len(text) < 32:
            raise FormatError(
                "the log's key is shorter than 32 characters",
                where=str(self.path),
                remedy="bring back the one that the log was written with",
            )
        return text.encode()

    def anchor(self) -> Head:
        """Return the newest code that was kept; the start of the chain if none was.

        Raises:
            FormatError: The file is damaged.
        """
        try:
            document: Mapping[str, Any] = json.loads(self.anchor_path.read_text(encoding="utf-8"))
            return Head(int(document["number"]), str(document["code"]))
        except FileNotFoundError:
            return Head()
        except (ValueError, KeyError, TypeError) as error:
            raise FormatError(
                "the newest code of the log is damaged",
                where=str(self.anchor_path),
                remedy="bring it back from the backup of the key",
            ) from error

    def keep(self, head: Head) -> None:
        """Keep the newest code."""
        write_text(self.anchor_path, canonical({"number": head.number, "code": head.code}) + "\n")
