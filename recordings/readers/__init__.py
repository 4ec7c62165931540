"""File formats: one reader a file, found by the ending of the file's name."""

from __future__ import annotations

from pathlib import Path

from foundation.errors import FormatError
from recordings.names import listing
from recordings.readers.asc import AscReader
from recordings.readers.base import (
    EVERYTHING,
    ColumnTable,
    RawSignal,
    RawTable,
    Reader,
    Request,
    Scope,
)
from recordings.readers.blf import BlfReader
from recordings.readers.candump import CandumpReader
from recordings.readers.csv import CsvReader
from recordings.readers.mat import MatReader
from recordings.readers.mf4 import Mf4Reader
from recordings.readers.parquet import ParquetReader
from recordings.readers.trc import TrcReader

READERS: tuple[Reader, ...] = (
    CsvReader(),
    ParquetReader(),
    MatReader(),
    Mf4Reader(),
    CandumpReader(),
    BlfReader(),
    AscReader(),
    TrcReader(),
)
"""Every format that can be read; a new one is added here."""

__all__ = [
    "EVERYTHING",
    "READERS",
    "ColumnTable",
    "RawSignal",
    "RawTable",
    "Reader",
    "Request",
    "Scope",
    "reader_for",
]


def reader_for(path: Path) -> Reader:
    """Return the reader for a file's name.

    Raises:
        FormatError: No reader has such an ending; lists those there are.

    Example:
        >>> type(reader_for(Path("Run7.CSV"))).__name__
        'CsvReader'
    """
    name = path.name.lower()
    for reader in READERS:
        if name.endswith(reader.suffixes):
            return reader
    known = [suffix for reader in READERS for suffix in reader.suffixes]
    raise FormatError(
        f"no reader for '{path.suffix or path.name}' files",
        where=str(path),
        remedy=f"convert it to one of: {listing(known)}",
    )
