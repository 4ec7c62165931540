"""MDF 4: files that asammdf writes come back, measured channels and logged frames alike."""

import struct

import asammdf
import cantools
import numpy as np
import pytest
from asammdf.blocks import v4_constants as v4
from asammdf.blocks.source_utils import Source
from hypothesis import given, settings
from hypothesis import strategies as st

from foundation.errors import ChannelError, FormatError, TwinproofError
from recordings import Kind, load, load_signals

TIME = np.arange(500) * 0.01


def save(path, *groups, version="4.10", **options):
    with asammdf.MDF(version=version) as file:
        for name, signals in groups:
            file.append(signals, acq_name=name)
        file.save(path, overwrite=True, **options)
    return path


def signal(name, values, time=TIME, **facts):
    return asammdf.Signal(np.asarray(values), time, name=name, **facts)


@pytest.mark.parametrize("compression", [0, 1, 2])
@pytest.mark.parametrize("version", ["4.00", "4.10", "4.11"])
def test_all_types_of_numbers(tmp_path, compression, version):
    rng = np.random.default_rng(compression)
    types = ["u1", "u2", "u4", "u8", "i1", "i2", "i4", "i8", "f4", "f8", ">u2", ">i4", ">f8", "f2"]
    expected = {}
    for k, kind in enumerate(types):
        native = np.dtype(kind).newbyteorder("=")
        bits = rng.integers(0, 2**64, TIME.size, np.uint64)
        numbers = rng.normal(size=TIME.size) if native.kind == "f" else bits.astype(native)
        expected[f"x{k}"] = numbers.astype(kind)
    path = save(
        tmp_path / "a.mf4",
        ("", [signal(n, x, unit="V") for n, x in expected.items()]),
        version=version,
        compression=compression,
    )
    run = load(path)
    assert sorted(run.channels) == sorted(expected)
    for name, values in expected.items():
        assert np.array_equal(run[name].values, values.astype(np.float64)), values.dtype
        assert run[name].unit == "V"
    assert np.array_equal(run.time, TIME)


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.floats(allow_nan=False, allow_infinity=False, width=64), min_size=2, max_size=300),
    st.integers(0, 2),
)
def test_any_numbers_come_back(tmp_path_factory, values, compression):
    path = tmp_path_factory.mktemp("mf4") / "a.mf4"
    time = np.arange(len(values)) * 0.5
    save(path, ("", [signal("x", values, time)]), compression=compression)
    assert load(path)["x"].values.tolist() == values


def test_long_files_are_read_in_pieces(tmp_path, monkeypatch):
    time = np.arange(60_000) * 0.001
    values = np.random.default_rng(0).integers(0, 9, time.size).astype("f8")
    path = save(tmp_path / "a.mf4", ("", [signal("x", values, time)]), compression=2)
    monkeypatch.setattr("recordings.readers.mdf_groups.PART", 1000)
    assert np.array_equal(load(path)["x"].values, values)


def test_groups_have_their_own_times_and_names(tmp_path):
    path = save(
        tmp_path / "a.mf4",
        ("fast", [signal("q", np.sin(TIME)), signal("n", np.arange(500))]),
        ("slow", [signal("n", np.arange(50), TIME[::10])]),
    )
    found = load_signals(path)
    assert sorted(found.samples) == ["fast.n", "q", "slow.n"]
    assert len(found["slow.n"]) == 50
    assert found["fast.n"].sensor.resolution == 1.0
    assert found["q"].sensor.resolution is None
    (tmp_path / "m.toml").write_text('[channels.x]\nsource = "qq"')
    with pytest.raises(ChannelError, match=r"no channel 'qq'.*did you mean q"):
        load(path, channel_map=tmp_path / "m.toml")


CONVERSIONS = {
    "linear": {"a": 0.25, "b": -3.0},
    "rational": {"P1": 0.0, "P2": 2.0, "P3": 1.0, "P4": 0.0, "P5": 0.5, "P6": 7.0},
    "table": {f"raw_{k}": 10.0 * k for k in range(6)} | {f"phys_{k}": k**2 for k in range(6)},
    "names": {"val_0": 0, "text_0": b"off", "val_1": 1, "text_1": b"on", "default": b"?"},
}


@pytest.mark.parametrize("kind", CONVERSIONS)
def test_conversions_are_those_of_asammdf(tmp_path, kind):
    raw = np.random.default_rng(0).integers(0, 2 if kind == "names" else 60, 500).astype("u1")
    path = save(tmp_path / "a.mf4", ("", [signal("x", raw, conversion=CONVERSIONS[kind])]))
    with asammdf.MDF(path) as file:
        expected = file.get("x", raw=True).physical(ignore_value2text_conversions=True).samples
    found = load_signals(path)["x"]
    np.testing.assert_allclose(found.values, expected, rtol=1e-12)
    assert found.kind is (Kind.STATE if kind == "names" else Kind.MEASURED)
    assert found.sensor.resolution == {"linear": 0.25, "names": None}.get(kind)


def test_invalid_samples_are_left_out(tmp_path):
    invalid = np.zeros(500, bool)
    invalid[[3, 7, 8]] = True
    values = np.arange(500.0)
    values[10] = np.nan
    path = save(
        tmp_path / "a.mf4",
        ("", [signal("x", values, invalidation_bits=invalid), signal("y", values)]),
    )
    found = load_signals(path)
    assert found["x"].values[:8].tolist() == [0, 1, 2, 4, 5, 6, 9, 11]
    assert "4 samples of 'x' are marked invalid: left out" in found.notes


def test_texts_are_no_channels(tmp_path):
    path = save(
        tmp_path / "a.mf4",
        ("", [signal("x", TIME), signal("t", np.array([b"abc"] * 500), encoding="utf-8")]),
    )
    assert list(load(path).channels) == ["x"]


DBC = """VERSION ""
BU_: X
BO_ 256 Motion: 8 X
 SG_ q : 0|32@1- (0.001,0) [0|0] "m" X
 SG_ v : 39|32@0- (0.01,0) [0|0] "m/s" X
BO_ 2147484160 Far: 8 X
 SG_ w : 0|16@1+ (1,0) [0|0] "V" X
"""


def frames(count=400, variable=False):
    """Bus logging as a logger writes it; every fourth frame has a 29-bit identifier."""
    rng = np.random.default_rng(1)
    record = np.zeros(
        count,
        [
            ("CAN_DataFrame.BusChannel", "u1"),
            ("CAN_DataFrame.ID", "<u4"),
            ("CAN_DataFrame.IDE", "u1"),
            ("CAN_DataFrame.DLC", "u1"),
            ("CAN_DataFrame.DataLength", "u1"),
            ("CAN_DataFrame.DataBytes", "u1", (8,)),
        ],
    )
    far = np.arange(count) % 4 == 0
    record["CAN_DataFrame.BusChannel"] = 1
    record["CAN_DataFrame.ID"] = np.where(far, 512, 256)
    record["CAN_DataFrame.IDE"] = far
    record["CAN_DataFrame.DLC"] = record["CAN_DataFrame.DataLength"] = 8
    record["CAN_DataFrame.DataBytes"] = rng.integers(0, 256, (count, 8))
    return record


@pytest.fixture
def logged(tmp_path):
    path, dbc = tmp_path / "log.mf4", tmp_path / "bus.dbc"
    dbc.write_text(DBC)
    record = frames()
    bus = asammdf.Signal(
        record,
        np.arange(400) * 0.01,
        name="CAN_DataFrame",
        source=Source("CAN", "CAN1", "", v4.SOURCE_BUS, v4.BUS_TYPE_CAN),
    )
    with asammdf.MDF(version="4.10") as file:
        file.append([bus], acq_name="CAN")
        file.append([signal("temperature", np.arange(500.0), unit="K")], acq_name="board")
        file.save(path, overwrite=True)
    return path, dbc, record


def test_logged_frames_are_decoded_as_cantools_does(logged):
    path, dbc, record = logged
    found = load_signals(path, dbc=dbc)
    message = cantools.database.load_file(dbc).get_message_by_name("Motion")
    near = record[record["CAN_DataFrame.ID"] == 256]
    expected = [message.decode(row["CAN_DataFrame.DataBytes"].tobytes()) for row in near]
    np.testing.assert_allclose(found["q"].values, [e["q"] for e in expected], rtol=1e-14)
    np.testing.assert_allclose(found["v"].values, [e["v"] for e in expected], rtol=1e-14)
    assert len(found["w"]) == 100
    np.testing.assert_allclose(found["w"].time, np.arange(100) * 0.04, atol=1e-9)
    assert found["q"].sensor.resolution == 0.001


def test_without_a_dbc_the_measured_channels_are_read(logged):
    path, _, _ = logged
    assert load(path)["temperature"].values[-1] == 499


def test_frames_alone_need_a_dbc(logged, tmp_path):
    _, dbc, record = logged
    alone = tmp_path / "alone.mf4"
    bus = asammdf.Signal(record, np.arange(400) * 0.01, name="CAN_DataFrame")
    save(alone, ("CAN", [bus]))
    with pytest.raises(FormatError, match=r"needs a DBC file .*--dbc"):
        load(alone)
    plain = save(tmp_path / "plain.mf4", ("", [signal("x", TIME)]))
    assert "the DBC bus.dbc is not used: plain.mf4 is no CAN log" in load(plain, dbc=dbc).notes


def test_other_files_and_versions(tmp_path):
    path = tmp_path / "a.mf4"
    path.write_bytes(b"time,q\n0,1\n")
    with pytest.raises(FormatError, match="not an MDF file"):
        load(path)
    path.write_bytes(b"MDF     3.30    ".ljust(200, b"\0"))
    with pytest.raises(FormatError, match=r"version 3\.30 .*convert it"):
        load(path)
    path.write_bytes(b"UnFinMF 4.10    ".ljust(200, b"\0"))
    with pytest.raises(FormatError, match="never finalized"):
        load(path)
    with asammdf.MDF(version="4.10") as file:
        file.save(path, overwrite=True)
    with pytest.raises(FormatError, match=r"no sample in the file"):
        load(path)


def blocks(content):
    """Where the blocks of a file begin, with their identifiers."""
    at = 64
    while at + 24 <= len(content):
        kind, length = content[at : at + 4], struct.unpack_from("<Q", content, at + 8)[0]
        if kind[:2] == b"##" and length >= 24:
            yield at, kind
            at += -(-length // 8) * 8
        else:
            at += 8


@pytest.mark.parametrize("kind", [b"##DG", b"##CG", b"##CN", b"##DL"])
def test_lists_that_go_round_end(tmp_path, kind):
    time = np.arange(600_000) * 0.001
    signals = [signal("x", time, time), signal("y", time, time)]
    path = save(tmp_path / "a.mf4", ("a", signals), ("b", signals[:1]), compression=1)
    content = bytearray(path.read_bytes())
    places = [at for at, found in blocks(content) if found == kind]
    assert places
    struct.pack_into("<Q", content, places[0] + 24, places[0])
    path.write_bytes(content)
    with pytest.raises(FormatError, match=r"a list that comes back to byte"):
        load(path)


def was_refused(path, dbc):
    """Whether a file is refused with an error of ours; anything else fails the test."""
    try:
        load(path, dbc=dbc)
    except TwinproofError as error:
        return bool(error.remedy)
    return False


@pytest.mark.parametrize("compression", [0, 2])
def test_no_damage_crashes_or_hangs(tmp_path, compression, logged):
    plain = save(
        tmp_path / "a.mf4",
        ("g", [signal("x", TIME), signal("n", np.arange(500))]),
        compression=compression,
    )
    rng = np.random.default_rng(compression)
    refused = 0
    for path, dbc in ((plain, None), logged[:2]):
        whole = path.read_bytes()
        starts = [at for at, _ in blocks(whole)]
        for k in range(250):
            content = bytearray(whole)
            # Half of the damage is put into the blocks' headers and links.
            at = (
                int(rng.choice(starts) + rng.integers(64))
                if k % 2
                else int(rng.integers(len(whole)))
            )
            content[min(at, len(whole) - 1)] = int(rng.choice([0, 1, 127, 255, rng.integers(256)]))
            path.write_bytes(content[: len(whole) if k % 5 else int(rng.integers(len(whole)))])
            refused += was_refused(path, dbc)
    assert refused > 150


class Builder:
    """Writes MDF 4 blocks by hand: unsorted files, which asammdf reads but does not write."""

    def __init__(self):
        self.content = bytearray(b"MDF     4.10    test    ".ljust(28, b"\0"))
        self.content += struct.pack("<H", 410)
        self.content = self.content.ljust(64 + 104, b"\0")

    def block(self, kind, links, data):
        at = len(self.content)
        size = 24 + 8 * len(links) + len(data)
        head = struct.pack("<4s4xQQ", kind, size, len(links))
        self.content += head + struct.pack(f"<{len(links)}Q", *links) + data
        self.content += bytes(-len(self.content) % 8)
        return at

    def text(self, text):
        return self.block(b"##TX", [], text.encode() + b"\0")

    def channel(self, following, name, kind, form, byte, bits, *, data=0, sync=0):
        numbers = struct.pack(
            "<BBBBIIIIBxHdddddd", kind, sync, form, 0, byte, bits, 0, 0, 0, 0, *([0.0] * 6)
        )
        return self.block(b"##CN", [following, 0, self.text(name), 0, 0, data, 0, 0], numbers)

    def group(self, following, channels, number, count, size, flags=0):
        numbers = struct.pack("<QQHHxxxxII", number, count, flags, ord("."), size, 0)
        return self.block(b"##CG", [following, channels, self.text("CAN"), 0, 0, 0], numbers)

    def save(self, path, data_group):
        history = self.block(
            b"##FH", [0, self.block(b"##MD", [], b"<FHcomment/>\0")], struct.pack("<Qhh4x", 0, 0, 0)
        )
        links = [data_group, history, 0, 0, 0, 0]
        head = struct.pack("<4s4xQQ6Q", b"##HD", 104, 6, *links) + struct.pack(
            "<Qhhhxxdd", *[0] * 6
        )
        self.content[64 : 64 + len(head[:104])] = head[:104]
        path.write_bytes(self.content)
        return path


@pytest.fixture
def unsorted(tmp_path):
    """Frames of two groups and their payloads of variable length, in one stream of records."""
    rng = np.random.default_rng(5)
    path, dbc = tmp_path / "u.mf4", tmp_path / "bus.dbc"
    dbc.write_text(DBC)
    stream, offset, payloads = bytearray(), 0, []
    for k in range(300):
        payload = rng.bytes(8)
        payloads.append(payload)
        stream += struct.pack("<BdIQ", 1, k * 0.01, 256, offset)
        stream += struct.pack("<BI", 2, 8) + payload
        offset += 12
        if k % 3 == 0:
            stream += struct.pack("<Bdh", 3, k * 0.01, k - 50)
    file = Builder()
    variable = file.group(0, 0, 2, 300, 0, flags=1)
    fields = file.channel(0, "CAN_DataFrame.DataBytes", 1, 10, 12, 64, data=variable)
    fields = file.channel(fields, "CAN_DataFrame.ID", 0, 0, 8, 32)
    fields = file.channel(fields, "t", 2, 4, 0, 64, sync=1)
    frame = file.channel(0, "CAN_DataFrame", 0, 10, 8, 96)
    struct.pack_into("<Q", file.content, frame + 24, fields)
    board = file.channel(0, "n", 0, 2, 8, 16)
    board = file.channel(board, "t", 2, 4, 0, 64, sync=1)
    groups = file.group(variable, frame, 1, 300, 20)
    groups = file.group(groups, board, 3, 100, 10)
    data = file.block(b"##DT", [], bytes(stream))
    file.save(path, file.block(b"##DG", [0, groups, data, 0], struct.pack("<B7x", 1)))
    return path, dbc, payloads


def test_unsorted_records_and_payloads_of_variable_length(unsorted):
    path, dbc, payloads = unsorted
    message = cantools.database.load_file(dbc).get_message_by_name("Motion")
    found = load_signals(path, dbc=dbc)
    expected = [message.decode(payload) for payload in payloads]
    np.testing.assert_allclose(found["q"].values, [e["q"] for e in expected], rtol=1e-14)
    np.testing.assert_allclose(found["q"].time, np.arange(300) * 0.01, atol=1e-9)
    board = load_signals(path)["n"]
    assert board.values.tolist() == list(range(-50, 250, 3))
    with asammdf.MDF(path) as file:
        assert bytes(file.get("CAN_DataFrame.DataBytes").samples[7]) == payloads[7]


@pytest.mark.parametrize("mistake", ["number", "length", "end", "offset"])
def test_unsorted_records_that_cannot_be_are_refused(unsorted, mistake):
    path, dbc, _ = unsorted
    content = bytearray(path.read_bytes())
    start = next(at for at, kind in blocks(content) if kind == b"##DT") + 24
    if mistake == "number":
        content[start] = 9
    elif mistake == "length":
        struct.pack_into("<I", content, start + 22, 1 << 30)
    elif mistake == "offset":
        struct.pack_into("<Q", content, start + 13, 1 << 40)
    else:
        struct.pack_into("<Q", content, start - 16, 24 + 30)
    path.write_bytes(content)
    with pytest.raises(FormatError, match=r"MDF file is cut or damaged: .*copy it again"):
        load(path, dbc=dbc)
