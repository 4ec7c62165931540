"""Signals out of CAN payloads, a column at a time, with NumPy.

A DBC places a signal by start bit, length and byte order. For Intel order the start bit is the
least significant one and bits count upwards through the bytes; for Motorola order it is the most
significant one and the signal runs towards later bytes. Either way the signal is a whole number
of neighbouring bytes, in one order or the other, shifted by less than a byte.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from cantools.database.can import Signal
from numpy.typing import NDArray

from foundation.errors import ChannelError

_FLOATS = {16: np.float16, 32: np.float32, 64: np.float64}


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
    first, last, shift = byte_span(signal)
    significant = payload[:, first:last]
    if signal.byte_order == "big_endian":
        significant = significant[:, ::-1]
    raw = np.zeros(len(payload), np.uint64)
    for k in range(significant.shape[1]):
        byte = significant[:, k].astype(np.uint64)
        # A ninth byte, of a long signal off the byte's edge, loses its upper bits on purpose.
        raw |= byte >> np.uint64(shift) if k == 0 else byte << np.uint64(8 * k - shift)
    if length < 64:
        raw &= np.uint64((1 << length) - 1)
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
    conversion = signal.conversion
    raw = raw_values(signal, payload).astype(np.float64)
    return raw * conversion.scale + conversion.offset
