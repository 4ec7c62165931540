"""Curves for drawing: kept whole on disk, handed out as few points as a screen can show."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.files import write_text, written_whole

Vector = NDArray[np.float32] | NDArray[np.float64]


def save(
    folder: Path, time: Vector, curves: Mapping[str, Vector], about: Mapping[str, Any]
) -> None:
    """Write curves over one time.

    Args:
        folder: One file a curve, so that what is not drawn is not read.
        time: (n,) in s.
        curves: Name → (n,); NaN where nothing is known.
        about: What the page needs to know beside the numbers.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, values in {"time": time, **dict(_numbered(curves))}.items():
        with written_whole(folder / f"{name}.npy") as beside, beside.open("wb") as file:
            np.save(file, np.asarray(values, dtype=np.float64 if name == "time" else np.float32))
    write_text(
        folder / "about.json", json.dumps({**about, "curves": list(curves), "n": len(time)}) + "\n"
    )


def _numbered(curves: Mapping[str, Vector]) -> list[tuple[str, Vector]]:
    # Names of variables are not always names of files.
    return [(f"curve{k}", values) for k, values in enumerate(curves.values())]


def about(folder: Path) -> dict[str, Any] | None:
    """Return what was written beside the numbers; None if there are none."""
    path = folder / "about.json"
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else None


def view(
    folder: Path, begin: float, end: float, points: int
) -> tuple[NDArray[np.float64], list[Vector]]:
    """Return what a screen shows of the curves between two times.

    Args:
        folder: Given to `save`.
        begin, end: Span [s].
        points: At most about so many; fewer samples come as they are.

    Returns:
        Times, and every curve in the order saved. Where there are more samples than points, each
        span of time has two: the least and the largest value in it.

    Raises:
        FileNotFoundError: Nothing was saved.
    """
    time = np.load(folder / "time.npy", mmap_mode="r")
    first = max(int(np.searchsorted(time, begin)) - 1, 0)
    last = min(int(np.searchsorted(time, end, side="right")) + 1, len(time))
    number = len(json.loads((folder / "about.json").read_text(encoding="utf-8"))["curves"])
    loaded = [np.load(folder / f"curve{k}.npy", mmap_mode="r")[first:last] for k in range(number)]
    part = np.asarray(time[first:last])
    if len(part) <= points:
        return part, [np.asarray(curve) for curve in loaded]
    edges = np.linspace(0, len(part), points // 2 + 1).astype(int)[:-1]
    return thin_time(part, edges), [extremes(np.asarray(curve), edges) for curve in loaded]


def thin_time(time: NDArray[np.float64], edges: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return two times for each span: its beginning and its middle."""
    ends = np.append(edges[1:], len(time))
    return np.column_stack([time[edges], time[(edges + ends) // 2]]).ravel()


def extremes(values: Vector, edges: NDArray[np.int64]) -> Vector:
    """Return the least and the largest value of each span; NaN where a span has none.

    Example:
        >>> extremes(np.array([0.0, 5, 1, -3, 2, np.nan]), np.array([0, 3])).tolist()
        [0.0, 5.0, -3.0, 2.0]
    """
    low = np.fmin.reduceat(values, edges)
    high = np.fmax.reduceat(values, edges)
    return np.column_stack([low, high]).ravel()
