"""Asking a running service."""

from __future__ import annotations

import json
import urllib.error
import urllib.parse
import urllib.request
from dataclasses import dataclass
from typing import Any

from foundation.errors import InputError

_PATIENCE = 10.0


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
        """Return what the service answers.

        Raises:
            ServiceSilentError: It does not answer, or not as the service does.
            InputError: It refuses: no such twin, no token, ….
        """
        if not self.url.startswith(("http://", "https://")):
            raise InputError(
                f"'{self.url}' is no address", where="--url", remedy="write http://127.0.0.1:8460"
            )
        headers = {"Authorization": f"Bearer {self.token}"} if self.token else {}
        request = urllib.request.Request(f"{self.url.rstrip('/')}{path}", headers=headers)
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
            raise InputError(
                said, where=self.url, remedy="correct the request, or show another token"
            ) from error
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
