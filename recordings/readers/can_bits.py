"""Signals out of CAN payloads, a column at a time, with NumPy.

A DBC places a signal by start bit, length and byte order. For Intel order the start bit is the
least significant one and bits count upwards through the bytes; for Motorola order it is the most
significant one and the signal runs towards later bytes. Either way the signal is a field of
neighbouring bits in a word of neighbouring bytes, read in one order or the other.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from cantools.database.can import Signal
from numpy.typing import NDArray

from foundation.errors import ChannelError

_FLOATS = {16: np.float16, 32: np.float32, 64: np.float64}
_WORD = 8
"""Bytes of a word."""


def byte_span(signal: Signal) -> tuple[int, int, int]:
    """Return where a signal lies: its first byte, one past its last, and the shift in bits.

    The shift is that of the least significant bit within the least significant byte, 0 to 7.

    Example:
        >>> byte_span(Signal("speed", start=4, length=12, byte_order="little_endian"))
        (0, 2, 4)
        >>> byte_span(Signal("speed", start=3, length=12, byte_order="big_endian"))
        (0, 2, 0)
    """
    if signal.byte_order == "little_endian":
        end = signal.start + signal.length
        return signal.start // 8, (end + 7) // 8, signal.start % 8
    begin = 8 * (signal.start // 8) + 7 - signal.start % 8
    last = (begin + signal.length + 7) // 8
    return begin // 8, last, 8 * last - begin - signal.length


def raw_values(
    signal: Signal, payload: NDArray[np.uint8]
) -> NDArray[np.integer[Any]] | NDArray[np.floating[Any]]:
    """Return a signal's unscaled values: uint64, int64 or a float type, shape (n,).

    Args:
        signal: From a DBC, up to 64 bits long.
        payload: Bytes of n frames, shape (n, width); every frame is long enough for the signal.

    Raises:
        ChannelError: The signal is longer than 64 bits, or a float of an odd length.
    """
    length = signal.length
    if not 1 <= length <= 64 or (signal.is_float and length not in _FLOATS):
        kind = "float" if signal.is_float else "signal"
        raise ChannelError(
            f"'{signal.name}' is a {kind} of {length} bits",
            remedy="leave it out: signals have up to 64 bits, floats 16, 32 or 64",
        )
    raw = _field(signal, payload)
    if signal.is_float:
        unsigned = raw.astype(np.dtype(f"u{length // 8}"))
        return unsigned.view(_FLOATS[length])
    if signal.is_signed:
        unused = np.int64(64 - length)
        # Shifting left and, with the sign, right again copies the sign bit over the unused ones.
        return (raw << np.uint64(unused)).view(np.int64) >> unused
    return raw


def scaled_values(signal: Signal, payload: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return a signal's physical values, in its unit, shape (n,); arguments as `raw_values`.

    Example:
        >>> angle = Signal("angle", start=0, length=8, is_signed=True)
        >>> scaled_values(angle, np.array([[1], [255]], np.uint8)).tolist()
        [1.0, -1.0]
    """
    return scaled(signal, raw_values(signal, payload))


def scaled(
    signal: Signal, raw: NDArray[np.integer[Any]] | NDArray[np.floating[Any]]
) -> NDArray[np.float64]:
    """Return physical values, shape (n,), of unscaled ones."""
    conversion = signal.conversion
    values = raw.astype(np.float64)
    values *= float(conversion.scale)
    values += float(conversion.offset)
    return values


def _field(signal: Signal, payload: NDArray[np.uint8]) -> NDArray[np.uint64]:
    """Return a signal's bits as unsigned numbers, shape (n,)."""
    first, last, shift = byte_span(signal)
    little = signal.byte_order == "little_endian"
    if last - first > _WORD:  # a long signal off the byte's edge: its ninth byte by itself
        ninth = last - 1 if little else first
        eight = first if little else first + 1
        word = words(payload[:, eight : eight + _WORD], little)
        upper = payload[:, ninth].astype(np.uint64) << np.uint64(64 - shift)
        raw = (word >> np.uint64(shift)) | upper
    else:
        # Any word that has the signal will do: of a frame of eight bytes it is the whole frame.
        begin = max(min(first, payload.shape[1] - _WORD), 0)
        word = words(payload[:, begin : begin + _WORD], little)
        shift += 8 * (first - begin if little else begin + _WORD - last)
        raw = word >> np.uint64(shift) if shift else word
    return raw & np.uint64((1 << signal.length) - 1)


def words(part: NDArray[np.uint8], little: bool) -> NDArray[np.uint64]:
    """Return bytes, shape (n, up to 8), as 64-bit words, shape (n,); missing bytes are zeros."""
    if part.shape[1] < _WORD:
        part = np.pad(part, ((0, 0), (0, _WORD - part.shape[1])))
    return np.ascontiguousarray(part).view("<u8" if little else ">u8")[:, 0]
