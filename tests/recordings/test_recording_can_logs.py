"""CAN logs: what their frames, stamps and DBC files can hold, right and wrong."""

import re
import struct

import can
import cantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foundation.errors import ChannelError, FormatError, RecordingError, TimeError
from recordings import Kind, load, load_signals
from recordings.readers import blf, candump
from recordings.readers.blf import BlfReader
from recordings.readers.can_frames import Frames
from recordings.readers.candump import CandumpReader

DBC = """VERSION ""
BU_: X
BO_ 256 Fast: 8 X
 SG_ angle : 0|16@1- (0.01,0) [0|0] "deg" X
 SG_ level : 32|32@1- (1,0) [0|0] "" X
BO_ 257 Slow: 2 X
 SG_ volt : 0|16@1- (0.001,0) [0|0] "V" X
 SG_ status : 8|4@1+ (1,0) [0|0] "" X
BO_ 2147484160 Mixed: 3 X
 SG_ page M : 0|8@1+ (1,0) [0|0] "" X
 SG_ temperature m1 : 8|16@1- (0.5,-40) [0|0] "degC" X
 SG_ current m2 : 15|16@0- (0.1,0) [0|0] "A" X
BO_ 300 Silent: 2 X
 SG_ pressure : 0|16@1+ (1,0) [0|0] "kPa" X
 SG_ status : 0|4@1+ (1,0) [0|0] "" X
BO_ 301 Other: 1 X
 SG_ status : 0|4@1+ (1,0) [0|0] "" X
SIG_VALTYPE_ 256 level : 1;
"""


@pytest.fixture
def bus(tmp_path):
    """Writes frames `(time, id, payload as hex)` as a log with its DBC; returns a loader."""
    dbc = tmp_path / "bus.dbc"
    dbc.write_text(DBC)

    def write(*lines, suffix=".log", **options):
        path = tmp_path / f"run{suffix}"
        rows = [x if isinstance(x, str) else f"({x[0]:.6f}) can0 {x[1]}#{x[2]}" for x in lines]
        path.write_text("\n".join(rows) + "\n")
        return load(path, dbc=dbc, **options)

    return write


def fast(t, angle=0, level=0.0):
    return (t, "100", np.int16(angle).tobytes().hex() + "0000" + np.float32(level).tobytes().hex())


def slow(t, volt=0):
    return (t, "101", np.int16(volt).tobytes().hex())


def test_values_units_resolution_and_time(bus):
    run = bus(
        fast(1600000000.25, -100, 1.5), fast(1600000000.75, 200, -2.5), variables={"angle": "rad"}
    )
    assert run.time.tolist() == [0.0, 0.5]
    np.testing.assert_allclose(run["angle"].values, np.deg2rad([-1, 2]), rtol=1e-15)
    assert run["angle"].unit == "rad"
    assert run["angle"].sensor.resolution == pytest.approx(np.deg2rad(0.01), rel=1e-12)
    assert "stamped 1600000000.250000 s" in run.notes[0]
    assert "ignored, not of the model: level" in run.notes


def test_floats_have_no_resolution(bus):
    run = bus(fast(0, 0, 1.5), fast(1, 0, -2.5))
    assert run["level"].values.tolist() == [1.5, -2.5]
    assert run["level"].sensor.resolution is None


def test_messages_are_put_on_the_time_of_the_fastest(bus):
    frames = [fast(k * 0.01, k) for k in range(11)] + [slow(0.015 + k * 0.04, k) for k in range(3)]
    frames.sort()
    run = bus(*frames, variables={"volt": "V", "angle": "deg"})
    np.testing.assert_allclose(run.time, np.arange(2, 10) * 0.01)
    np.testing.assert_allclose(run["angle"].values, np.arange(2, 10) * 0.01)
    np.testing.assert_allclose(run["volt"].values, (run.time - 0.015) / 40)
    assert "interpolated to the times of 'angle': volt" in run.notes


def test_shared_stamps_are_kept_to_the_last_bit(bus):
    frames = [f(k / 1000, k) for k in range(20) for f in (fast, slow)]
    run = bus(*frames, variables={"volt": "V", "angle": "deg"})
    assert run.time.tolist() == [k / 1000 for k in range(20)]
    assert not any("interpolated" in note for note in run.notes)


def test_a_gap_that_is_bridged_is_said(bus):
    volts = [0.0, 0.1, 0.2, 0.3, 1.3, 1.4]
    frames = sorted([fast(k * 0.01) for k in range(150)] + [slow(t) for t in volts])
    run = bus(*frames, variables={"volt": "V", "angle": "deg"})
    assert any("'volt' has 1 gaps" in n and "1 s at 0.3 s" in n for n in run.notes)


def test_signals_that_never_overlap(bus):
    with pytest.raises(TimeError, match=r"'volt' starts at 5 s, 'angle' ends at 1 s.*leave one"):
        bus(fast(0), fast(1), slow(5), slow(6), variables={"volt": "V", "angle": "deg"})


def test_multiplexed_signals_have_the_frames_of_their_page(bus):
    frames = [
        (0.1 * k, "00000200", f"{1 + k % 2:02x}{'0a00' if k % 2 == 0 else '000a'}")
        for k in range(8)
    ]
    both = bus(*frames)
    assert set(both["temperature"].values) == {-35.0}
    assert set(both["current"].values) == {1.0}
    one = bus(*frames, variables={"current": "mA"})
    np.testing.assert_allclose(one.time, [0.1, 0.3, 0.5, 0.7])
    np.testing.assert_allclose(one["current"].values, 1000.0)


def test_other_frames_are_counted(bus):
    run = bus(
        fast(0),
        "(0.1) can0 20000080#0000000000000000",
        "(0.2) can0 100#R8",
        "(0.3) can0 7FF#",
        "(0.3) can0 00000100#00",
        fast(0.5),
        variables={"angle": "deg"},
    )
    text = "; ".join(run.notes)
    assert "2 of 4 frames are of messages that the DBC does not describe" in text
    assert "1 error frames left out" in text
    assert "1 remote frames left out" in text


def test_short_frames_and_repeated_stamps_are_said(bus):
    run = bus(
        fast(0, 1), (0.1, "100", "05"), fast(0.2, 2), fast(0.2, 3), variables={"angle": "deg"}
    )
    assert run.time.tolist() == [0.0, 0.2]
    assert run["angle"].values.tolist() == [0.01, 0.03]
    text = "; ".join(run.notes)
    assert "1 frames of Fast are too short for 'angle'" in text
    assert "1 frames of Fast have the time stamp of the next" in text


@pytest.mark.parametrize(
    ("lines", "error", "fragments"),
    [
        (["hello"], FormatError, ["line 1", "'hello'", "candump -L"]),
        ([fast(0), "(1.0) can0 100#0A0", fast(2)], FormatError, ["line 2", "remove the line"]),
        (["  can0  100   [2]  00 00"], FormatError, ["line 1", "candump -L"]),
        ([""], FormatError, ["no frame", "record it again"]),
        (["(0.2) can0 100#R8"], FormatError, ["no frame"]),
        ([(0, "7A0", "00")], FormatError, ["bus.dbc", "has 0x7A0;", "has 0x100, 0x101, 0x12C"]),
        ([fast(1), fast(0.5)], TimeError, ["goes back", "-0.5 s follows 0 s", "Fast", "frame 2"]),
        ([fast(0)], ChannelError, ["'angle' has fewer than two values"]),
        (
            [fast(0), "(0.1) can1 100#0000000000000000"],
            ChannelError,
            ["message Fast arrives on several buses (can0, can1)", 'bus = "can0"'],
        ),
    ],
)
def test_bad_logs_name_place_and_remedy(bus, lines, error, fragments):
    with pytest.raises(error) as caught:
        bus(*lines, variables={"angle": "deg"})
    message = str(caught.value)
    assert "run.log" in message
    assert caught.value.remedy
    for fragment in fragments:
        assert fragment in message


def test_a_cut_last_line_says_that_the_log_was_cut(tmp_path):
    path, dbc = tmp_path / "a.log", tmp_path / "b.dbc"
    dbc.write_text(DBC)
    path.write_text("(0.0) can0 100#0000\n(0.1) can0 1")
    with pytest.raises(FormatError, match=r"line 2\); the log was cut: remove its last line"):
        load(path, dbc=dbc)


def test_wanted_signals_that_are_not_there(bus, tmp_path):
    mapping = tmp_path / "map.toml"
    options = {"variables": {"p": "kPa"}, "channel_map": mapping}
    mapping.write_text('[channels.p]\nsource = "angel"')
    with pytest.raises(ChannelError, match=r"no signal 'angel' .*did you mean angle"):
        bus(fast(0), fast(1), **options)
    mapping.write_text('[channels.p]\nsource = "pressure"')
    with pytest.raises(
        ChannelError, match=r"in the DBC, but no frame of its message Silent \(0x12C\)"
    ):
        bus(fast(0), fast(1), **options)
    with pytest.raises(ChannelError, match=r"named as a variable of the model \(V\).*--map.*angle"):
        bus(fast(0), fast(1), variables={"V": "V"})


def test_a_name_in_several_messages_needs_the_longer_one(bus, tmp_path):
    mapping = tmp_path / "map.toml"
    frames = [(0, "101", "0003"), (0, "12D", "05"), (1, "101", "0003"), (1, "12D", "05")]
    mapping.write_text('[channels.s]\nsource = "status"')
    with pytest.raises(ChannelError, match=r"write source as Slow\.status or Other\.status"):
        bus(*frames, variables={"s": ""}, channel_map=mapping)
    mapping.write_text('[channels.s]\nsource = "Other.status"')
    assert bus(*frames, variables={"s": ""}, channel_map=mapping)["s"].values.tolist() == [5, 5]
    assert sorted(bus(*frames).channels) == ["Other.status", "Slow.status", "volt"]


def test_dbc_problems(tmp_path):
    log, dbc = tmp_path / "run.log", tmp_path / "bus.dbc"
    log.write_text("(0.0) can0 100#0000\n(0.1) can0 100#0000\n")
    with pytest.raises(FormatError, match=r"needs a DBC file .*--dbc"):
        load(log)
    with pytest.raises(RecordingError, match=r"cannot be read: No such file .*bus\.dbc.*--dbc"):
        load(log, dbc=dbc)
    dbc.write_text('VERSION ""\nBU_: X\nBO_ 256 Fast 8 X\n')
    with pytest.raises(FormatError, match=r"not a DBC file: .*line 3.*repair"):
        load(log, dbc=dbc)
    dbc.write_text('VERSION ""\nBU_: X\n')
    with pytest.raises(FormatError, match=r"describes no message"):
        load(log, dbc=dbc)


def test_a_dbc_for_a_table_is_not_used_and_said(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time,q\n0,1\n1,2\n")
    assert load(path, dbc=tmp_path / "bus.dbc").notes == (
        "the DBC bus.dbc is not used: run.csv is no CAN log",
    )


def blf_frames(path, n=3):
    with can.BLFWriter(path) as log:
        for k in range(n):
            log(
                can.Message(
                    timestamp=k + 0.5e-9, arbitration_id=256, is_extended_id=False, data=bytes(8)
                )
            )
        log(can.Message(timestamp=n, is_error_frame=True))
        log(
            can.Message(timestamp=n, arbitration_id=256, is_extended_id=False, is_remote_frame=True)
        )
        fd = bytes([2, 0, 0, 10]) + bytes(60)
        log(can.Message(timestamp=n, arbitration_id=512, data=fd, is_fd=True))


def test_blf_counts_errors_and_remotes_and_reads_fd(tmp_path):
    path, dbc = tmp_path / "run.blf", tmp_path / "bus.dbc"
    dbc.write_text(DBC)
    blf_frames(path)
    run = load(path, dbc=dbc, variables={"angle": "deg"})
    assert run.time.tolist() == [0, 1, 2]
    assert {"1 error frames left out", "1 remote frames left out"} <= set(run.notes)


@pytest.mark.parametrize("keep", [0.3, 0.6, 0.99])
def test_a_cut_blf_says_where(tmp_path, keep):
    path, dbc = tmp_path / "run.blf", tmp_path / "bus.dbc"
    dbc.write_text(DBC)
    blf_frames(path, n=2000)
    content = path.read_bytes()
    path.write_bytes(content[: int(keep * len(content))])
    with pytest.raises(
        FormatError, match=r"the BLF file is cut \(.*byte 144 of \d+\); copy it again"
    ):
        load(path, dbc=dbc)
    path.write_bytes(content[:144])
    with pytest.raises(FormatError, match=r"no frame"):
        load(path, dbc=dbc)
    path.write_bytes(content[:144] + b"JUNK" * 50)
    with pytest.raises(FormatError, match=r"no object where one is due .*byte 144"):
        load(path, dbc=dbc)
    path.write_bytes(b"time,q\n")
    with pytest.raises(FormatError, match=r"not a BLF file"):
        load(path, dbc=dbc)


def test_sixty_thousand_frames_agree_with_cantools(tmp_path):
    rng = np.random.default_rng(0)
    path, dbc = tmp_path / "run.log", tmp_path / "bus.dbc"
    dbc.write_text(DBC)
    payloads = rng.integers(0, 256, (60_000, 8), np.uint8)
    payloads[:, 4:] = rng.normal(size=60_000).astype("<f4").view(np.uint8).reshape(-1, 4)
    path.write_text(
        "".join(f"({k / 1000:.6f}) can0 100#{p.tobytes().hex()}\n" for k, p in enumerate(payloads))
    )
    run = load(path, dbc=dbc)
    message = cantools.database.load_string(DBC, strict=False).get_message_by_name("Fast")
    for k in range(0, 60_000, 1000):
        expected = message.decode(payloads[k].tobytes())
        assert run["angle"].values[k] == pytest.approx(expected["angle"], rel=1e-14)
        assert run["level"].values[k] == expected["level"]


def test_the_bus_key_chooses_between_buses(bus, tmp_path):
    mapping = tmp_path / "map.toml"
    mapping.write_text('[channels.angle]\nbus = "can1"')
    frames = [fast(k / 10, k) for k in range(5)]
    other = [f"({k / 10 + 0.05:.6f}) can1 100#{fast(0, -k)[2]}" for k in range(5)]
    lines = [line for pair in zip(frames, other, strict=True) for line in pair]
    run = bus(*lines, variables={"angle": "deg"}, channel_map=mapping)
    np.testing.assert_allclose(run["angle"].values, -0.01 * np.arange(5), atol=1e-15)
    np.testing.assert_allclose(run.time, 0.05 + 0.1 * np.arange(5))
    mapping.write_text('[channels.angle]\nbus = "vcan"')
    with pytest.raises(ChannelError, match=r"Fast is on bus vcan.*there are: can0, can1"):
        bus(*lines, variables={"angle": "deg"}, channel_map=mapping)


def test_one_variable_from_each_bus(bus, tmp_path):
    mapping = tmp_path / "map.toml"
    mapping.write_text(
        '[channels.a]\nsource = "angle"\nbus = "can0"\n[channels.b]\nsource = "angle"\nbus = "can1"'
    )
    lines = [f"({k}.0) can{b} 100#{fast(0, 10 * b + k)[2]}" for k in range(4) for b in (0, 1)]
    run = bus(*lines, variables={"a": "deg", "b": "deg"}, channel_map=mapping)
    np.testing.assert_allclose(run["b"].values - run["a"].values, 0.1)


def test_named_values_at_the_top_of_the_range_are_none(tmp_path):
    path, dbc = tmp_path / "run.log", tmp_path / "bus.dbc"
    dbc.write_text(
        'VERSION ""\nBU_: X\nBO_ 256 M: 2 X\n SG_ level : 0|8@1+ (0.5,0) [0|0] "V" X\n'
        ' SG_ gear : 8|4@1+ (1,0) [0|0] "" X\n'
        'VAL_ 256 level 255 "SNA" 254 "Sensor error" 0 "Not connected" ;\n'
        'VAL_ 256 gear 0 "Neutral" 1 "First" 2 "Second" 15 "Not available" ;\n'
    )
    levels, gears = [2, 255, 4, 254, 0, 8], [0, 0, 1, 1, 15, 2]
    pairs = zip(levels, gears, strict=True)
    path.write_text("".join(f"({k}.0) can0 100#{a:02X}{g:02X}\n" for k, (a, g) in enumerate(pairs)))
    signals = load_signals(path, dbc=dbc)
    assert signals["level"].values.tolist() == [1, 2, 0, 4]
    assert signals["level"].time.tolist() == [0, 2, 4, 5]
    assert signals["gear"].values.tolist() == [0, 0, 1, 1, 2]
    assert (signals["level"].kind, signals["gear"].kind) == (Kind.MEASURED, Kind.STATE)
    assert "2 values of 'level' say that there is none" in signals.notes
    run = signals.recording()
    assert set(run["gear"].values) <= {0.0, 1.0, 2.0}


def test_floats_that_are_not_numbers_are_left_out(bus):
    run = bus(fast(0, 0, 1), fast(1, 0, np.nan), fast(2, 0, np.inf), fast(3, 0, 4), fast(4, 0, 5))
    assert run.raw["level"].values.tolist() == [1, 4, 5]
    assert "2 values of 'level' say that there is none" in run.notes


@settings(max_examples=40)
@given(st.data())
def test_any_candump_lines_are_read_as_line_by_line(tmp_path_factory, data):
    """Lines of all forms in any order, against the regular expression of the format."""
    line = st.builds(
        "({}.{}) {} {}#{}{}".format,
        st.integers(0, 2_000_000_000),
        st.integers(0, 999_999).map("{:06d}".format),
        st.sampled_from(["can0", "can1", "vcan10"]),
        st.one_of(
            st.integers(0, 0x7FF).map("{:03X}".format),
            st.integers(0, 0x1FFFFFFF).map("{:08x}".format),
        ),
        st.one_of(
            st.binary(max_size=8).map(bytes.hex),
            st.binary(max_size=8).map(lambda b: b.hex().upper()),
            st.binary(max_size=64).map(lambda b: "#1" + b.hex()),
            st.just("R8"),
        ),
        st.sampled_from(["", " R", " T", "  "]),
    )
    pool = data.draw(st.lists(line, min_size=1, max_size=8))
    lines = data.draw(st.lists(st.sampled_from(pool), min_size=1, max_size=80))
    path = tmp_path_factory.mktemp("log") / "a.log"
    path.write_text(data.draw(st.sampled_from(["\n", "\r\n"])).join(lines) + "\n")
    size, PART = candump.PART, data.draw(st.sampled_from([60, 200, candump.PART]))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(candump, "PART", PART)
        parts = list(CandumpReader().frames(path))
    found = []
    for part in parts:
        for k in range(len(part)):
            name = part.bus_names[part.bus[k]]
            payload = bytes(part.payload[k, : part.length[k]])
            assert not part.payload[k, part.length[k] :].any()
            found.append((part.nanoseconds[k], part.identifier[k], name, payload))
    expected, remotes = [], 0
    for text in lines:
        match = re.fullmatch(r"\((\d+)\.(\d+)\) (\S+) (\w+)#(#1|R8)?(\w*)( .*)?", text)
        if match[5] == "R8":
            remotes += 1
            continue
        flag = 1 << 31 if len(match[4]) == 8 else 0
        nanoseconds = int(match[1]) * 10**9 + int(match[2]) * 1000
        expected.append((nanoseconds, int(match[4], 16) | flag, match[3], bytes.fromhex(match[6])))
    assert found == expected
    assert sum(part.remote_frames for part in parts) == remotes
    assert size == candump.PART


@pytest.mark.parametrize("line", ["(1.0) can0 100#0A0", "(1.0) can0 100#0G", "(1,0) can0 100#00"])
def test_one_bad_line_among_many_is_found(tmp_path, line):
    path = tmp_path / "a.log"
    lines = ["(1.0) can0 100#0A0B"] * 5000
    lines[3210] = line
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(FormatError, match=r"a\.log, line 3211\)"):
        list(CandumpReader().frames(path))


@pytest.fixture
def mixed_blf(tmp_path):
    """Frames of every sort that python-can writes, in one file."""
    rng = np.random.default_rng(4)
    path = tmp_path / "run.blf"
    with can.BLFWriter(path) as log:
        for k in range(3000):
            fd = bool(rng.integers(2))
            size = int(rng.choice([0, 3, 8, 12, 64] if fd else range(9)))
            log(
                can.Message(
                    timestamp=1.6e9 + k * 1e-3,
                    arbitration_id=int(rng.integers(0x800)),
                    is_extended_id=bool(rng.integers(2)),
                    is_fd=fd,
                    is_remote_frame=not fd and k % 50 == 0,
                    channel=int(rng.integers(3)),
                    data=b"LOBJ" * 2 if k % 100 == 1 and not fd else rng.bytes(size),
                )
            )
    return path


def test_blf_is_what_python_can_reads(mixed_blf, monkeypatch):
    for part in (1, 1 << 14, 1 << 19):
        monkeypatch.setattr(blf, "PART", part)
        frames = list(BlfReader().frames(mixed_blf))
        joined = Frames.joined(frames)
        expected = [m for m in can.BLFReader(mixed_blf) if not m.is_remote_frame]
        assert len(joined) == len(expected) > 2900
        np.testing.assert_allclose(joined.nanoseconds / 1e9, [m.timestamp for m in expected])
        assert joined.bus.tolist() == [m.channel + 1 for m in expected]
        for k, message in enumerate(expected):
            flag = 1 << 31 if message.is_extended_id else 0
            assert joined.identifier[k] == message.arbitration_id | flag
            assert joined.length[k] == len(message.data)
            assert bytes(joined.payload[k]) == bytes(message.data).ljust(64, b"\0")
        assert sum(f.remote_frames for f in frames) == 3000 - len(expected)


def blf_objects(path, *objects):
    """Write a BLF of one container that is not packed."""
    head = struct.pack("<4sL", b"LOGG", 144).ljust(40, b"\0") + struct.pack(
        "<8H", 2021, 9, 0, 12, 3, 35, 14, 717
    )
    content = b"".join(objects)
    size = 32 + len(content)
    container = struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, size, 10, 0, len(content)) + content
    path.write_bytes(head.ljust(144, b"\0") + container)


def blf_object(kind, body, ticks=0, version=1, clock=2, padding=0):
    rest = struct.pack("<LHHQ", clock, 0, 0, ticks).ljust(16 if version == 1 else 24, b"\0")
    size = 16 + len(rest) + len(body)
    return struct.pack("<4sHHLL", b"LOBJ", 32, version, size, kind) + rest + body + bytes(padding)


@pytest.mark.parametrize("padding", [0, 1, 2, 3])
def test_blf_objects_of_other_writers(tmp_path, padding):
    path = tmp_path / "run.blf"
    classic = struct.pack("<HBBL8s", 2, 0, 8, 0x123, bytes(range(8)))
    fd64 = struct.pack(
        "<BBBBLLLLLLLHBBL", 1, 15, 6, 0, 0x80000456, 0, 0x1000, 0, 0, 0, 0, 0, 0, 0, 0
    )
    blf_objects(
        path,
        blf_object(86, classic, 5, version=2, clock=1, padding=padding),
        blf_object(115, b"unknown!" * 3, 6, padding=padding),
        blf_object(101, fd64 + b"abcd", 70_000, padding=padding),
        blf_object(73, bytes(32), 80_000, padding=padding),
        blf_object(1, classic, 90_000, padding=padding),
    )
    frames = Frames.joined(list(BlfReader().frames(path)))
    expected = [m for m in can.BLFReader(path) if not m.is_error_frame]
    assert [bytes(m.data) for m in expected] == [
        bytes(p[:n]) for p, n in zip(frames.payload, frames.length, strict=True)
    ]
    start = round(expected[0].timestamp * 1e9) - 50_000
    assert (frames.nanoseconds - frames.nanoseconds[0]).tolist() == [0, 20_000, 40_000]
    assert abs(frames.nanoseconds[0] - 50_000 - start) < 1000
    assert frames.identifier.tolist() == [0x123, 0x80000456, 0x123]
    assert frames.error_frames == 1
    assert bytes(frames.payload[1, :6]) == b"abcd\0\0"


def test_a_blf_object_too_short_for_its_kind_is_refused(tmp_path):
    path = tmp_path / "run.blf"
    blf_objects(path, blf_object(1, b"1234"))
    with pytest.raises(FormatError, match=r"too short for its kind .*byte 144"):
        list(BlfReader().frames(path))
