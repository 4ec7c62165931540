"""The files of a data set: in `$TWINPROOF_DATA`, in the user's cache, or downloaded."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import pooch

from foundation.errors import FormatError, RecordingError
from recordings.datasets.registry import DataFile, DataSet, find

FOLDER_VARIABLE = "TWINPROOF_DATA"
"""Environment variable that names a folder with the data sets' files."""


@dataclass(frozen=True)
class DataFiles:
    """Where the files of a data set are on this machine.

    Attributes:
        data: The recording.
        dbc: Describes its messages, if it is a CAN log.
    """

    data: Path
    dbc: Path | None


def fetch(name: str) -> DataFiles:
    """Return the files of a data set; they are downloaded if they are not on this machine.

    Raises:
        UnknownNameError: There is no data set of that name.
        FormatError: A file's content is not the registered one.
        RecordingError: The file is not here and cannot be downloaded.
    """
    data_set = find(name)
    dbc = _file(data_set, data_set.dbc) if data_set.dbc else None
    return DataFiles(_file(data_set, data_set.data), dbc)


def _file(data_set: DataSet, file: DataFile) -> Path:
    folder = os.environ.get(FOLDER_VARIABLE)
    if folder and (path := Path(folder) / file.local).is_file():
        _check(path, file.sha256)
        return path
    return _downloaded(data_set, file)


def _check(path: Path, sha256: str) -> None:
    status = path.stat()
    if _sha256(path, status.st_size, status.st_mtime_ns) != sha256:
        raise FormatError(
            "the file's content is not the registered one (SHA-256 differs)",
            where=str(path),
            remedy=f"remove it, so that it is downloaded, or name it as a file, not from "
            f"${FOLDER_VARIABLE}",
        )


@lru_cache(maxsize=64)
def _sha256(path: Path, size: int, changed: int) -> str:
    del size, changed  # they make the cache forget a file that was written anew
    return pooch.file_hash(str(path), alg="sha256")


def _downloaded(data_set: DataSet, file: DataFile) -> Path:
    """Return the file from the cache, where pooch puts it after checking what it downloads."""
    target = pooch.os_cache("twinproof") / file.local
    url = data_set.url(file)
    pooch.get_logger().setLevel("WARNING")
    try:
        pooch.retrieve(url, f"sha256:{file.sha256}", fname=target.name, path=target.parent)
    except ValueError as error:
        raise FormatError(
            f"what was downloaded for '{data_set.name}' is not the registered file "
            "(SHA-256 differs)",
            where=url,
            remedy="try again later; a proxy may have answered in the origin's place",
        ) from error
    except OSError as error:  # the class that requests' errors derive from
        raise RecordingError(
            f"data set '{data_set.name}' is not on this machine and cannot be downloaded: "
            f"{type(error).__name__}",
            where=url,
            remedy=f"get it elsewhere and set {FOLDER_VARIABLE} to the folder that has "
            f"{file.local}",
        ) from error
    return target
