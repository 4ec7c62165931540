"""Where made artefacts are kept between runs: named by what they were made from."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import pooch

CACHE_VARIABLE = "TWINPROOF_CACHE"


def cache_folder(kind: str) -> Path:
    """Return the folder of one kind of artefact (not created), e.g. `libraries`.

    `$TWINPROOF_CACHE` overrides the user's cache folder of the platform.
    """
    root = os.environ.get(CACHE_VARIABLE)
    return (Path(root) if root else Path(pooch.os_cache("twinproof"))) / kind


def content_key(*parts: str) -> str:
    """Return a name for whatever is determined by `parts`: 32 hexadecimal digits.

    Example:
        >>> content_key("a", "b") == content_key("ab")
        False
    """
    digest = hashlib.sha256()
    for part in parts:
        encoded = part.encode()
        digest.update(len(encoded).to_bytes(8, "big"))
        digest.update(encoded)
    return digest.hexdigest()[:32]
