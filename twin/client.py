"""Asking a running service."""

from __future__ import annotations

import json
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from foundation.errors import InputError

_PATIENCE = 10.0
_REMEDIES = {
    401: "give a file with one: --token-file, or set TWINPROOF_TOKEN",
    403: "`twinproof twin token NAME --scope SCOPE` makes a token; the service's settings name "
    "their file: service.tokens",
}


class ServiceSilentError(InputError):
    """The service does not answer, or something else answers in its place."""


@dataclass(frozen=True)
class Client:
    """Asks a service.

    Attributes:
        url: `http://127.0.0.1:8460`.
        token: To show; empty: none.
    """

    url: str
    token: str = ""

    @staticmethod
    def quoted(name: str) -> str:
        """Return a name as it can stand in an address."""
        return urllib.parse.quote(name, safe="")

    def get(self, path: str) -> dict[str, Any]:
        """Return what the service answers; errors as `post`."""
        return self._ask(path, None)

    def post(self, path: str, body: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Have the service do something, and return what it answers.

        Args:
            path: Of the API.
            body: Of the request, as JSON.

        Raises:
            ServiceSilentError: It does not answer, or not as the service does.
            InputError: It refuses: no such twin, no token, ….
        """
        return self._ask(path, json.dumps(body or {}).encode())

    def _ask(self, path: str, body: bytes | None) -> dict[str, Any]:
        if not self.url.startswith(("http://", "https://")):
            raise InputError(
                f"'{self.url}' is no address", where="--url", remedy="write http://127.0.0.1:8460"
            )
        headers = {"Authorization": f"Bearer {self.token}"} if self.token else {}
        if body is not None:
            headers["Content-Type"] = "application/json"
        request = urllib.request.Request(f"{self.url.rstrip('/')}{path}", body, headers)
        remedy = "start it with `twinproof twin serve`, or correct --url"
        try:
            with urllib.request.urlopen(request, timeout=_PATIENCE) as answer:
                found = json.load(answer)
        except urllib.error.HTTPError as error:
            with error:
                said = _detail(error.read())
            if error.code >= 500 or not said:
                raise ServiceSilentError(
                    f"the service fails: {said or error.reason}", where=self.url, remedy=remedy
                ) from error
            # What the service says of a request has its own remedy.
            raise InputError(said, where=self.url, remedy=_REMEDIES.get(error.code, "")) from error
        except (OSError, ValueError) as error:
            reason = getattr(error, "reason", None) or error
            raise ServiceSilentError(
                f"the service does not answer: {reason}", where=self.url, remedy=remedy
            ) from error
        if not isinstance(found, dict):
            raise ServiceSilentError(
                "something else than the service answers", where=self.url, remedy=remedy
            )
        return found


def _detail(content: bytes) -> str:
    try:
        detail = json.loads(content)["detail"]
    except (ValueError, KeyError, TypeError):
        return ""
    if isinstance(detail, str):
        return detail
    return "; ".join(str(d.get("msg", d)) if isinstance(d, dict) else str(d) for d in detail)
