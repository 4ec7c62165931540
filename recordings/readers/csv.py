"""Comma-separated values: a header with the columns' names, then one row a sample."""

from __future__ import annotations

import csv
import warnings
from collections.abc import Sequence
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd

from foundation.errors import ChannelError, FormatError
from recordings.readers.base import EVERYTHING, RawSignal, RawTable, Reader, Request, Scope

FIRST_ROW_LINE = 2
"""Line of the file on which the first row of numbers stands: the header is line 1."""


class CsvReader(Reader):
    """CSV in UTF-8, separated by commas, semicolons or tabs; decimals have a point."""

    suffixes = (".csv",)

    def read(self, path: Path, *, dbc: Path | None = None, scope: Scope = EVERYTHING) -> RawTable:
        """Read the file; see `Reader.read`."""
        del dbc, scope
        try:
            # Blank lines at the end are nothing; any other would shift the line numbers below.
            text = path.read_text(encoding="utf-8-sig").rstrip()
        except UnicodeDecodeError as error:
            raise FormatError(
                f"not text in UTF-8 (byte {error.start})",
                where=str(path),
                remedy="export it again as CSV in UTF-8",
            ) from error
        if not text:
            raise FormatError("the file is empty", where=str(path), remedy="record it again")
        header, separator = _header(text.splitlines()[0], path)
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            try:
                frame = pd.read_csv(
                    StringIO(text),
                    sep=separator,
                    header=None,
                    names=range(len(header)),
                    skiprows=1,
                    index_col=False,
                    skip_blank_lines=False,
                    skipinitialspace=True,
                    low_memory=False,
                )
            except (pd.errors.ParserError, pd.errors.ParserWarning) as error:
                reason = str(error).split("C error: ")[-1].strip().rstrip(".")
                raise FormatError(
                    f"rows do not fit the header of {len(header)} columns: {reason}",
                    where=str(path),
                    remedy="repair that line, or record it again if the file was cut",
                ) from error
        if frame.empty:
            raise FormatError(
                "there is a header but no row", where=str(path), remedy="record it again"
            )
        columns = {name: frame.iloc[:, k] for k, name in enumerate(header) if name}
        return _CsvTable(columns, str(path))


class _CsvTable(RawTable):
    """Columns that are checked only when they are used: a comment column does no harm."""

    def __init__(self, columns: dict[str, pd.Series], origin: str) -> None:
        self._columns = columns
        self.origin = origin

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._columns)

    def signals(self, requests: Sequence[Request]) -> list[RawSignal]:
        return [self._signal(self.plain(request)) for request in requests]

    def _signal(self, name: str) -> RawSignal:
        if name not in self._columns:
            raise self.missing(name)
        column = self._columns[name]
        numbers = np.asarray(pd.to_numeric(column, errors="coerce"), np.float64)
        finite = np.isfinite(numbers)
        if not np.all(finite):
            row = int(np.argmin(finite))
            cell = column.iloc[row]
            text = "empty or NaN" if pd.isna(cell) else f"'{cell}'"
            remedy = "write decimals with a point" if "," in text else "repair or remove the row"
            raise ChannelError(
                f"column '{name}' is {text} where a number is wanted",
                where=f"{self.origin}, line {row + FIRST_ROW_LINE}",
                remedy=remedy,
            )
        return RawSignal(name, numbers)


def _header(line: str, path: Path) -> tuple[list[str], str]:
    separator = max(",;\t", key=line.count)
    header = [cell.strip() for cell in _cells(line, separator)]
    if all(_is_number(cell) for cell in header if cell):
        raise FormatError(
            "the first line has numbers, not the columns' names",
            where=f"{path}, line 1",
            remedy="add a header such as time,q,v",
        )
    for k, name in enumerate(header):
        if name and name in header[:k]:
            raise ChannelError(
                f"columns {header.index(name) + 1} and {k + 1} are both named '{name}'",
                where=f"{path}, line 1",
                remedy="rename or remove one",
            )
    return header, separator


def _cells(line: str, separator: str) -> list[str]:
    return next(csv.reader([line], delimiter=separator, skipinitialspace=True))


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
