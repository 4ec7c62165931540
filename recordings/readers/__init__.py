"""File formats: one reader a file, found by the ending of the file's name."""

from __future__ import annotations

from pathlib import Path

from foundation.errors import FormatError
from recordings.names import listing
from recordings.readers.base import ColumnTable, RawSignal, RawTable, Reader
from recordings.readers.blf import BlfReader
from recordings.readers.candump import CandumpReader
from recordings.readers.csv import CsvReader
from recordings.readers.mat import MatReader

READERS: tuple[Reader, ...] = (CsvReader(), MatReader(), CandumpReader(), BlfReader())
"""Every format that can be read; a new one is added here."""

__all__ = ["READERS", "ColumnTable", "RawSignal", "RawTable", "Reader", "reader_for"]


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
