"""A measured figure beside the limit it should keep."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """One line of the benchmark's table.

    Attributes:
        name: What was measured.
        value: The figure.
        limit: What it should keep; None for a figure that is only shown.
        at_least: The limit is a lower one.
        unit: Of value and limit.
    """

    name: str
    value: float
    limit: float | None = None
    unit: str = ""
    at_least: bool = False

    @property
    def kept(self) -> bool:
        """Whether the limit is kept."""
        if self.limit is None:
            return True
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    def __str__(self) -> str:
        limit = ""
        if self.limit is not None:
            limit = f"{'≥' if self.at_least else '≤'} {self.limit:g} {self.unit}"
        mark = "kept" if self.kept else "MISSED"
        return f"{self.name:<58} {self.value:>12.4g} {self.unit:<8} {limit:<16} {mark}"
