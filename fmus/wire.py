"""Messages between a process and its child: JSON and arrays of double, nothing that can run.

A message is the length of its JSON (8 bytes), the JSON, then the arrays it speaks of. The child
runs foreign code, so what comes from it is parsed as data only, and its size is bounded.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

Message: TypeAlias = dict[str, Any]

LARGEST = 4 * 1024**3
_LARGEST_TEXT = 64 * 1024**2
_ARRAY = "\N{WHITE SQUARE}array"


class WireError(Exception):
    """The other side said something that is no message, or hung up."""


def encode(message: Message) -> list[bytes]:
    """Return the parts of a message to send, one after the other.

    Example:
        >>> parts = encode({"a": np.array([1.0, 2.0]), "b": ["x", None]})
        >>> stream = b"".join(parts)
        >>> position = 0
        >>> def receive(n):
        ...     global position
        ...     position += n
        ...     return stream[position - n : position]
    """
    arrays: list[bytes] = []
    text = json.dumps(_without_arrays(message, arrays)).encode()
    return [len(text).to_bytes(8, "little"), text, *arrays]


def _without_arrays(value: Any, arrays: list[bytes]) -> Any:
    if isinstance(value, np.ndarray):
        content = np.ascontiguousarray(value, np.float64)
        arrays.append(content.tobytes())
        return {_ARRAY: list(content.shape)}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, dict):
        return {str(key): _without_arrays(item, arrays) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_arrays(item, arrays) for item in value]
    return value


def decode(receive: Callable[[int], bytes]) -> Message:
    """Read one message.

    Args:
        receive: Returns exactly as many bytes as asked for, or raises WireError.

    Raises:
        WireError: It is malformed or too large.
    """
    size = int.from_bytes(receive(8), "little")
    if size > _LARGEST_TEXT:
        raise WireError("the message is too long")
    try:
        message = json.loads(receive(size))
        if not isinstance(message, dict):
            raise WireError("the message is no object")
        return _with_arrays(message, receive, [LARGEST])
    except (ValueError, TypeError, RecursionError) as error:
        raise WireError("the message is malformed") from error


def _with_arrays(value: Any, receive: Callable[[int], bytes], left: list[int]) -> Any:
    if isinstance(value, list):
        return [_with_arrays(item, receive, left) for item in value]
    if not isinstance(value, dict):
        return value
    if _ARRAY in value:
        shape = tuple(int(n) for n in value[_ARRAY])
        size = 8 * math.prod(shape)
        left[0] -= size
        if any(n < 0 for n in shape) or left[0] < 0:
            raise WireError("the message is too long")
        return np.frombuffer(receive(size), np.float64).reshape(shape).copy()
    return {key: _with_arrays(item, receive, left) for key, item in value.items()}
