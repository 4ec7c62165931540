"""Columnwise decoding of CAN signals, against cantools frame by frame."""

import numpy as np
import pytest
from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion
from hypothesis import given, settings
from hypothesis import strategies as st

from foundation.errors import ChannelError
from recordings.readers.can_bits import raw_values, scaled_values

WIDTHS = (1, 2, 3, 8, 12, 64)


@st.composite
def layouts(draw):
    """A signal anywhere in a payload, of either order, with the payload's width."""
    width = draw(st.sampled_from(WIDTHS))
    is_float = width >= 2 and draw(st.booleans())
    if is_float:
        length = draw(st.sampled_from([n for n in (16, 32, 64) if n <= 8 * width]))
    else:
        length = draw(st.integers(1, min(64, 8 * width)))
    begin = draw(st.integers(0, 8 * width - length))
    order = draw(st.sampled_from(["little_endian", "big_endian"]))
    signal = Signal(
        "s",
        # Motorola start bits are counted within bytes from the other end.
        start=begin if order == "little_endian" else 8 * (begin // 8) + 7 - begin % 8,
        length=length,
        byte_order=order,
        is_signed=draw(st.booleans()) and not is_float,
        conversion=BaseConversion.factory(
            scale=draw(st.sampled_from([1, 2, 0.1, -0.0155168902])),
            offset=draw(st.sampled_from([0, -40, 6.315])),
            is_float=is_float,
        ),
    )
    return signal, width


@settings(max_examples=400)
@given(layouts(), st.data())
def test_random_layouts_decode_as_cantools_does(layout, data):
    signal, width = layout
    frames = data.draw(st.lists(st.binary(min_size=width, max_size=width), min_size=1, max_size=5))
    message = Message(1, "M", width, [signal], strict=True)
    expected_raw = [message.decode(f, scaling=False, decode_choices=False)["s"] for f in frames]
    expected = [message.decode(f, decode_choices=False)["s"] for f in frames]
    payload = np.frombuffer(b"".join(frames), np.uint8).reshape(-1, width)
    with np.errstate(invalid="ignore", over="ignore"):
        raw = raw_values(signal, payload)
        scaled = scaled_values(signal, payload)
    if signal.is_float:
        np.testing.assert_array_equal(raw, np.array(expected_raw))
    else:
        assert raw.tolist() == expected_raw  # exact, all 64 bits of it
    np.testing.assert_allclose(scaled, np.array(expected, float), rtol=1e-12, atol=1e-9)


def test_every_place_and_length_in_eight_bytes():
    rng = np.random.default_rng(3)
    payload = rng.integers(0, 256, (3, 8), np.uint8)
    tried = 0
    for length in range(1, 65):
        for begin in range(65 - length):
            intel = Signal("s", begin, length, "little_endian", is_signed=bool(begin % 2))
            start = 8 * (begin // 8) + 7 - begin % 8
            motorola = Signal("s", start, length, "big_endian", is_signed=bool(begin % 2))
            for signal in (intel, motorola):
                message = Message(1, "M", 8, [signal], strict=True)
                expected = [message.decode(bytes(frame))["s"] for frame in payload]
                assert raw_values(signal, payload).tolist() == expected
                tried += 1
    assert tried == 2 * 64 * 65 // 2


def test_what_cannot_be_decoded_is_refused():
    payload = np.zeros((1, 64), np.uint8)
    with pytest.raises(ChannelError, match="signal of 65 bits; leave it out"):
        raw_values(Signal("s", 0, 65), payload)
    odd = Signal("s", 0, 24, conversion=BaseConversion.factory(is_float=True))
    with pytest.raises(ChannelError, match="float of 24 bits"):
        raw_values(odd, payload)
