"""What a long computation knows, taken out of it and put into another that was made alike."""

from __future__ import annotations

from typing import Any, ClassVar, cast


class Resumable:
    """Base of what can be left at one place and taken up at another.

    A class names in `_changes` all attributes that change while it works. What its construction
    makes of its arguments (equations, compiled functions, open files) is not among them: who takes
    it up makes it from the same arguments, then resumes.

    Example:
        >>> class Counter(Resumable):
        ...     _changes = ("count",)
        ...     def __init__(self) -> None:
        ...         self.count = 0
        >>> one, other = Counter(), Counter()
        >>> one.count = 3
        >>> other.resume(one.snapshot())
        >>> other.count
        3
    """

    _changes: ClassVar[tuple[str, ...]] = ()

    def snapshot(self) -> dict[str, Any]:
        """Return what it knows: plain values, not copied. Write them down before it goes on."""
        return {name: _taken(getattr(self, name)) for name in self._changes}

    def resume(self, found: dict[str, Any]) -> None:
        """Know what another knew.

        Raises:
            ValueError: That one was made otherwise.
        """
        if set(found) != set(self._changes):
            raise ValueError(f"{type(self).__name__} has other attributes: {sorted(found)}")
        for name, value in found.items():
            _put(self, name, value)


def _is_list(value: object) -> bool:
    return isinstance(value, list) and any(
        isinstance(v, Resumable) for v in cast("list[object]", value)
    )


def _taken(value: Any) -> Any:
    if isinstance(value, Resumable):
        return value.snapshot()
    return [_taken(v) for v in value] if _is_list(value) else value


def _put(owner: Resumable, name: str, value: Any) -> None:
    there = getattr(owner, name)
    if isinstance(there, Resumable):
        there.resume(value)
    elif _is_list(there):
        for part, found in zip(there, value, strict=True):
            part.resume(found)
    else:
        setattr(owner, name, value)
