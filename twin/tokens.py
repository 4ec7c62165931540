"""Who may do what: tokens with scopes, of which only hashes are kept.

[[token]]
name = "maria"
sha256 = "…"                            # written by `twinproof twin token`
scopes = ["read", "operate", "approve"]
"""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from foundation.errors import InputError, UnknownNameError
from foundation.files import write_text
from hil.settings import build, read_toml


class Scope(Enum):
    """What a token may do."""

    READ = "read"
    """See everything."""
    OPERATE = "operate"
    """Ask for verifications, reload the settings."""
    APPROVE = "approve"
    """Put parameters into force, and roll them back."""


@dataclass(frozen=True, kw_only=True)
class Token:
    """A token, as the file has it.

    Attributes:
        name: Of its owner: what the log names.
        sha256: Of the token.
        scopes: What it may do.
    """

    name: str
    sha256: str
    scopes: tuple[str, ...] = ("read",)

    def __post_init__(self) -> None:
        known = [scope.value for scope in Scope]
        for scope in self.scopes:
            if scope not in known:
                raise UnknownNameError("scope", scope, known)
        if len(self.sha256) != 64 or not self.name:
            raise InputError(
                f"the token '{self.name}' has no name or no hash",
                remedy="write tokens with `twinproof twin token NAME`",
            )

    def may(self, scope: Scope) -> bool:
        """Return whether it may do something."""
        return scope.value in self.scopes


@dataclass(frozen=True)
class Tokens:
    """All tokens; none: only reading, and only on this machine.

    Example:
        >>> tokens = Tokens((Token(name="maria", sha256=hashed("secret"), scopes=("read",)),))
        >>> tokens.find("secret").name, tokens.find("guess")
        ('maria', None)
    """

    tokens: tuple[Token, ...] = ()

    def find(self, secret: str) -> Token | None:
        """Return the token that somebody shows."""
        shown = hashed(secret)
        found = [t for t in self.tokens if secrets.compare_digest(t.sha256, shown)]
        return found[0] if found else None

    def __bool__(self) -> bool:
        return bool(self.tokens)


def hashed(secret: str) -> str:
    """Return what is kept of a token. Tokens are random and long: no salt is needed."""
    return hashlib.sha256(secret.encode()).hexdigest()


def read_tokens(path: Path) -> Tokens:
    """Read a file of tokens.

    Raises:
        InputError: It cannot be read, or says something that cannot be.
    """
    table = read_toml(path)
    table.only(["token"])
    found = tuple(build(Token, t) for t in table.subs("token"))
    names = [t.name for t in found]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"two tokens are called '{name}'", where=str(path), remedy="rename one"
            )
    return Tokens(found)


def add_token(path: Path, name: str, scopes: Sequence[str]) -> str:
    """Make a token, keep its hash in a file, and return it: it cannot be shown again.

    Raises:
        InputError: The name is taken or cannot be written, or a scope is unknown.
    """
    if not name or not all(c.isalnum() or c in "-_.@" for c in name):
        raise InputError(f"'{name}' is no name", remedy="use letters, digits and - _ . @")
    known = read_tokens(path) if path.exists() else Tokens()
    if any(t.name == name for t in known.tokens):
        raise InputError(
            f"there is a token '{name}' already",
            where=str(path),
            remedy="remove its table first, or choose another name",
        )
    secret = secrets.token_urlsafe(32)
    token = Token(name=name, sha256=hashed(secret), scopes=tuple(scopes))
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    listed = ", ".join(f'"{scope}"' for scope in token.scopes)
    table = f'[[token]]\nname = "{name}"\nsha256 = "{token.sha256}"\nscopes = [{listed}]\n'
    write_text(path, f"{text}\n{table}" if text else table)
    path.chmod(0o600)
    return secret
