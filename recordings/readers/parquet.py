"""Parquet: columns with their units in the metadata; only the columns asked for are read.

A column's unit is what its field's metadata say under `unit` or `units`. A column of time stamps
is seconds since its first row, one of durations is seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.errors import ChannelError, FormatError
from recordings.readers.base import EVERYTHING, RawSignal, RawTable, Reader, Request, Scope
from recordings.readers.optional import library

_UNIT_KEYS = (b"unit", b"units", b"Unit")


class ParquetReader(Reader):
    """Parquet with one column a signal."""

    suffixes = (".parquet",)

    def read(self, path: Path, *, dbc: Path | None = None, scope: Scope = EVERYTHING) -> RawTable:
        """Open the file; see `Reader.read`."""
        del dbc, scope
        parquet = library("pyarrow.parquet", "parquet", path)
        with path.open("rb") as file:
            if not file.read(4):
                raise FormatError("the file is empty", where=str(path), remedy="record it again")
        try:
            file = parquet.ParquetFile(path)
            schema = file.schema_arrow
            rows = int(file.metadata.num_rows)
        except Exception as error:  # Arrow's own classes and OSError, by where the damage is
            raise _damaged(error, path) from error
        for name in schema.names:
            if schema.names.count(name) > 1:
                raise ChannelError(
                    f"two columns are named '{name}'", where=str(path), remedy="rename one"
                )
        if not rows:
            raise FormatError(
                "there are columns but no row", where=str(path), remedy="record it again"
            )
        return _ParquetTable(path, file, schema)


class _ParquetTable(RawTable):
    def __init__(self, path: Path, file: Any, schema: Any) -> None:
        self.origin = str(path)
        self._path = path
        self._file = file
        self._schema = schema

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._schema.names)

    def signals(self, requests: Sequence[Request]) -> list[RawSignal]:
        return [self._signal(self.plain(request)) for request in requests]

    def _signal(self, name: str) -> RawSignal:
        if name not in self.names:
            raise self.missing(name)
        field = self._schema.field(name)
        # A name may have dots, which Arrow takes for fields of structures: find it by itself.
        try:
            column = self._file.read(columns=[name]).column(name)
            if column.null_count:
                row = int(np.argmax(column.is_null().to_numpy()))
                raise ChannelError(
                    f"column '{name}' is empty where a number is wanted",
                    where=f"{self.origin}, row {row + 1}",
                    remedy="fill or remove the row",
                )
            values = column.to_numpy()
        except ChannelError:
            raise
        except Exception as error:  # Arrow's own classes and OSError, by where the damage is
            raise _damaged(error, self._path) from error
        numbers, unit = self._numbers(name, values)
        metadata = field.metadata or {}
        said = next(
            (metadata[key].decode("utf-8", "replace") for key in _UNIT_KEYS if key in metadata),
            unit,
        )
        return RawSignal(name, numbers, None, said, None, values.dtype.kind == "b")

    def _numbers(self, name: str, values: NDArray[Any]) -> tuple[NDArray[np.float64], str | None]:
        """Return a column as numbers, and the unit that its type implies."""
        if values.dtype.kind == "M":
            values = values - values[0]
        if values.dtype.kind == "m":
            return values / np.timedelta64(1, "ns").astype(values.dtype) / 1e9, "s"
        try:
            return np.asarray(values, np.float64), None
        except (ValueError, TypeError) as error:
            raise ChannelError(
                f"column '{name}' is of {self._schema.field(name).type}, not numbers",
                where=self.origin,
                remedy="leave it out of the channel map",
            ) from error


def _damaged(error: Exception, path: Path) -> FormatError:
    return FormatError(
        f"not a whole Parquet file: {' '.join(str(error).split()) or type(error).__name__}",
        where=str(path),
        remedy="copy it again, or write it again",
    )
