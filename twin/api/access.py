"""Who may ask what: bearer tokens with scopes; without tokens, only reading from this machine."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, HTTPException, Request
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from twin.settings import LOOPBACK
from twin.tokens import Scope, Token, Tokens

_BEARER = HTTPBearer(auto_error=False, description="Made by `twinproof twin token NAME`.")
_ANONYMOUS = Token(name="anonymous", sha256="0" * 64, scopes=("read",))

Credentials = Annotated[HTTPAuthorizationCredentials | None, Depends(_BEARER)]


class Requires:
    """The dependency that lets only tokens with a scope pass, and gives the token."""

    def __init__(self, scope: Scope) -> None:
        self.scope = scope

    async def __call__(self, request: Request, credentials: Credentials) -> Token:
        """Return the token that is shown."""
        tokens: Tokens = request.app.state.tokens
        if not tokens:
            if self.scope is Scope.READ:
                return _ANONYMOUS
            raise HTTPException(
                403, f"this needs a token with scope '{self.scope.value}': none are set up"
            )
        found = None if credentials is None else tokens.find(credentials.credentials)
        if found is None:
            raise HTTPException(
                401, "show a token: Authorization: Bearer …", {"WWW-Authenticate": "Bearer"}
            )
        if not found.may(self.scope):
            raise HTTPException(403, f"the token '{found.name}' has no scope '{self.scope.value}'")
        return found


Operator = Annotated[Token, Depends(Requires(Scope.OPERATE))]
Approver = Annotated[Token, Depends(Requires(Scope.APPROVE))]


def refuse_foreign_hosts(request: Request, tokens: Tokens) -> str:
    """Return why a request is refused before anything else; empty if it is not.

    Without tokens this machine is trusted, but not a page from elsewhere that a browser on it has
    been made to ask us by another name for this machine.
    """
    host = request.headers.get("host", "")
    name = host.rsplit(":", 1)[0] if not host.endswith("]") else host
    if not tokens and name.strip("[]") not in (*LOOPBACK, "testserver", ""):
        return f"'{host}' is not this machine"
    return ""
