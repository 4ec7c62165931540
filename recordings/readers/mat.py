"""MATLAB files of versions 5 to 7: every real vector is a column, fields of structs with dots."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
from numpy.typing import NDArray

from foundation.errors import FormatError
from recordings.names import listing
from recordings.readers import mat5
from recordings.readers.base import EVERYTHING, ColumnTable, RawTable, Reader, Scope


class MatReader(Reader):
    """MATLAB versions 5 to 7 (`save -v7`)."""

    suffixes = (".mat",)

    def read(self, path: Path, *, dbc: Path | None = None, scope: Scope = EVERYTHING) -> RawTable:
        """Read the file; see `Reader.read`."""
        del dbc, scope
        file = path.read_bytes()
        if file[:10] == b"MATLAB 7.3":
            raise FormatError(
                "a MATLAB 7.3 file",
                where=str(path),
                remedy="save it again with save('name.mat', '-v7')",
            )
        try:
            mat5.check(file)
            content = scipy.io.loadmat(BytesIO(file), simplify_cells=True)
        except Exception as error:  # SciPy's parser raises nearly anything on a damaged file
            raise FormatError(
                f"not a whole MATLAB file: {error}",
                where=str(path),
                remedy="copy it again, and save it with save('name.mat', '-v7')",
            ) from error
        found = dict(_numeric(content))
        columns = {name: array for name, array in found.items() if array.ndim == 1}
        others = [f"{n} {'x'.join(map(str, a.shape))}" for n, a in found.items() if a.ndim > 1]
        if not columns:
            what = f"only {listing(others)}" if others else "no numeric variable"
            raise FormatError(
                f"no vector in the file: {what}",
                where=str(path),
                remedy="save time and each signal as a vector of its own",
            )
        notes = (f"matrices are not read: {listing(others)}",) if others else ()
        return ColumnTable(columns, str(path), notes)


def _numeric(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the real arrays of more than one number, (n,) or more dimensions, by dotted name."""
    for key, value in content.items():
        if key.startswith("__"):
            continue
        if isinstance(value, dict):
            yield from _numeric(value, f"{prefix}{key}.")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.size > 1:
            yield f"{prefix}{key}", value.astype(np.float64)
