"""Formats whose library is installed on demand."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from foundation.errors import FormatError


def library(name: str, extra: str, path: Path) -> Any:
    """Import a library that reads a file, or say how to install it.

    Args:
        name: The module.
        extra: What to install: `pip install "twinproof[extra]"`.
        path: The file, for the message.

    Raises:
        FormatError: It is not installed.

    Example:
        >>> library("json", "parquet", Path("run.parquet")).loads("1")
        1
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise FormatError(
            f"{name.partition('.')[0]}, which reads this format, is not installed",
            where=str(path),
            remedy=f'pip install "twinproof[{extra}]"',
        ) from error
