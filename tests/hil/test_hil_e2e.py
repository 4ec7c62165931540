import pytest
from crccheck.crc import Crc8, Crc8Autosar, Crc8SaeJ1850, Crc16Autosar
from hypothesis import given
from hypothesis import strategies as st

from foundation.errors import BusError, UnknownNameError
from hil.bus import PROFILES, Checking, Counting, Protection, Status

# Examples of the E2E Protocol Specification (PRS_E2EProtocol): payloads of zeros.
EXAMPLES = [
    ("P01", 0x123, 0, "cc00000000000000"),
    ("P01", 0x123, 1, "9101000000000000"),
    ("P11", 0x123, 0, "cc00000000000000"),
    ("P11", 0x123, 1, "9101000000000000"),
    ("P05", 0x1234, 0, "1cca000000000000"),
    ("P05", 0x1234, 1, "cf8d010000000000"),
]


@pytest.mark.parametrize(("profile", "data_id", "counter", "expected"), EXAMPLES)
def test_published_example(profile, data_id, counter, expected):
    payload = bytearray(8)
    protection = Protection.of(profile, data_id)
    protection.protect(payload, counter)
    assert payload.hex() == expected
    assert protection.is_intact(payload)
    assert protection.counter(payload) == counter


@pytest.mark.parametrize(
    ("start", "counter", "ids", "expected"),
    [
        (bytes(8), 1, bytes(16), "4501000000000000"),
        (bytes(range(8)), 2, bytes(range(16)), "bc02020304050607"),
        (bytes(range(8)), 1, bytes(range(16)), "6101020304050607"),
    ],
)
def test_published_example_of_profile_2(start, counter, ids, expected):
    payload = bytearray(start)
    Protection.of("P02", 0, ids).protect(payload, counter)
    assert payload.hex() == expected


class AutosarCrc8(Crc8):
    """CRC-8 SAE J1850 as E2E profile 1 starts and ends it: with zero."""

    _poly, _initvalue, _xor_output = 0x1D, 0x00, 0x00
    _check_data, _check_result = b"123456789", 0x37


@given(st.binary(min_size=8, max_size=8), st.integers(0, 0xFFFF), st.integers(0, 14))
def test_against_checksums_of_another_library(content, data_id, counter):
    payload = bytearray(content)
    Protection.of("P11", data_id).protect(payload, counter)
    identifier = data_id.to_bytes(2, "little")
    assert payload[0] == AutosarCrc8.calc(identifier + bytes(payload[1:]))
    assert payload[1] == content[1] & 0xF0 | counter
    payload = bytearray(content)
    Protection.of("P05", data_id).protect(payload, counter)
    assert int.from_bytes(payload[:2], "little") == Crc16Autosar.calc(payload[2:] + identifier)
    payload = bytearray(content)
    ids = bytes((data_id + k) & 0xFF for k in range(16))
    Protection.of("P02", 0, ids).protect(payload, counter)
    assert payload[0] == Crc8Autosar.calc(payload[1:] + ids[counter : counter + 1])


def test_check_values_of_the_published_checksums():
    assert Crc8SaeJ1850.calc(b"123456789") == 0x4B
    assert Crc8Autosar.calc(b"123456789") == 0xDF
    assert Crc16Autosar.calc(b"123456789") == 0x29B1


@given(
    st.sampled_from(["P01", "P05", "P11"]),
    st.binary(min_size=8, max_size=8),
    st.integers(0, 0xFFFF),
    st.integers(0, 63),
)
def test_every_single_wrong_bit_is_seen(profile, content, data_id, bit):
    protection = Protection.of(profile, data_id)
    payload = bytearray(content)
    protection.protect(payload, 3)
    payload[bit // 8] ^= 1 << bit % 8
    assert not protection.is_intact(payload)


def frames(count: int, profile: str = "P11") -> tuple[Protection, list[bytes]]:
    protection = Protection.of(profile, 0x101)
    sender = Counting(protection)
    sent = []
    for _ in range(count):
        payload = bytearray(8)
        sender.protect(payload)
        sent.append(bytes(payload))
    return protection, sent


@pytest.mark.parametrize("profile", ["P01", "P05", "P11"])
def test_counter_goes_round(profile):
    protection, sent = frames(2 * PROFILES[profile].modulus + 3, profile)
    receiver = Checking(protection)
    assert [receiver.check(f) for f in sent] == [Status.INITIAL] + [Status.OK] * (len(sent) - 1)
    assert receiver.lost == 0


def test_what_a_receiver_makes_of_trouble():
    protection, sent = frames(30)
    receiver = Checking(protection, most_lost=2)
    order = [0, 1, 1, 4, 3, 5, 10, 11, 12]
    expected = [
        *("initial", "ok", "repeated", "some lost", "wrong sequence", "ok"),
        *("wrong sequence", "ok", "ok"),
    ]
    assert [receiver.check(sent[k]).value for k in order] == expected
    assert receiver.lost == 2 + 4
    assert receiver.check(b"\x00" * 8) is Status.WRONG_CHECKSUM
    assert receiver.check(b"") is Status.WRONG_CHECKSUM


def test_frame_under_a_wrong_identifier_is_refused():
    _, sent = frames(1)
    assert not Protection.of("P11", 0x102).is_intact(sent[0])


def test_unknown_profile_and_missing_list():
    with pytest.raises(UnknownNameError, match="P11"):
        Protection.of("P12", 1)
    with pytest.raises(BusError, match="16 bytes"):
        Protection.of("P02", 1)
