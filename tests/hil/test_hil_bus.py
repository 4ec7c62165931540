import os
import select
import subprocess
import sys
import time
from pathlib import Path

import can
import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.archive import describe
from fmus.package import cached_fmu
from fmus.sources import library_class
from foundation.errors import BusError, DivergenceError, FormatError, UnitError, UnknownNameError
from hil.bus import (
    BusSettings,
    Packer,
    PeriodicSender,
    Port,
    Statistics,
    Status,
    Unpacker,
    bridged_terminals,
    bundled_dbc,
    layouts,
    open_bus,
    parse_dbc,
    plant_dbc,
    protection_of,
    read_dbc,
    sends_to,
)
from hil.bus.dbc import BUNDLED
from hil.bus.slcan import SlcanBus, frame_of, line_of
from modelica import LIBRARY
from recordings import load

PLANTS = sorted(path.stem for path in (LIBRARY / "Plants").glob("[A-Z]*.mo"))
OUTPUTS = [Port("theta", "rad"), Port("omega", "rad/s"), Port("x", "m")]


def make_layouts(text=None, ports=OUTPUTS, **settings):
    return layouts(parse_dbc(text or plant_dbc([Port("V", "V")], OUTPUTS)), ports, **settings)


@pytest.mark.parametrize("plant", PLANTS)
def test_bundled_dbc_is_what_the_plants_ports_make(plant):
    described = describe(cached_fmu(library_class(f"Twinproof.Plants.{plant}")))
    inputs, outputs = (
        [Port(v.name, v.unit, v.description) for v in group]
        for group in (described.inputs, described.outputs)
    )
    text = bundled_dbc(f"Twinproof.Plants.{plant}").read_text(encoding="utf-8")
    assert text == plant_dbc(inputs, outputs)
    database = read_dbc(bundled_dbc(plant))
    assert len(layouts(database, [*inputs, *outputs])) >= 2
    for message in database.messages:
        protection = protection_of(message)
        assert protection is not None
        assert protection.profile.name == "P11"
        assert protection.data_id == message.frame_id
        assert message.cycle_time == 1


def test_there_is_a_dbc_for_every_plant_and_no_other():
    assert sorted(path.stem for path in BUNDLED.glob("*.dbc")) == PLANTS


@given(
    st.floats(-800, 800),
    st.floats(-800, 800),
    st.floats(-8, 8),
)
def test_values_survive_the_bus_to_half_a_step(theta, omega, x):
    found = make_layouts()
    unpacker = Unpacker(found)
    values = {"theta": theta, "omega": omega, "x": x}
    got = {}
    for layout in found:
        got |= unpacker.unpack(Packer(layout).pack(values)).values
    assert got["theta"] == pytest.approx(theta, abs=0.51e-4)
    assert got["omega"] == pytest.approx(omega, abs=0.51e-4)
    assert got["x"] == pytest.approx(x, abs=0.51e-6)


def test_cantools_reads_what_we_pack():
    first = make_layouts()[0]
    frame = Packer(first).pack({"theta": 1.5, "omega": -2.0})
    database = cantools.database.load_string(plant_dbc([Port("V", "V")], OUTPUTS), "dbc")
    decoded = database.decode_message(frame.arbitration_id, frame.data)
    assert decoded["theta"] == pytest.approx(1.5)
    assert decoded["omega"] == pytest.approx(-2.0)
    assert decoded["Sensors1_Counter"] == 0


def test_units_are_converted_both_ways():
    text = plant_dbc([], [Port("theta", "deg")])
    (layout,) = make_layouts(text, [Port("theta", "rad")])
    frame = Packer(layout).pack({"theta": 3.14159265})
    (raw,) = layouts(parse_dbc(text), [Port("theta", "deg")])
    assert Unpacker([raw]).unpack(frame).values["theta"] == pytest.approx(180.0, abs=1e-3)
    assert Unpacker([layout]).unpack(frame).values["theta"] == pytest.approx(3.14159265, abs=1e-5)


def test_other_signal_names_and_foreign_dbc_without_protection():
    demo = Path(__file__).parents[2] / "twinproof" / "demo_data" / "wheeled_pendulum.dbc"
    found = layouts(
        read_dbc(demo),
        [Port("theta_p", "rad"), Port("omega_p", "rad/s")],
        signals={"theta_p": "Pitch", "omega_p": "PitchRate"},
    )
    frame = Packer(found[0]).pack({"theta_p": 0.1, "omega_p": 0.2})
    reading = Unpacker(found).unpack(frame)
    assert reading.status is Status.OK
    assert reading.values["theta_p"] == pytest.approx(0.1, abs=1e-4)


def test_what_is_wrong_with_a_dbc_is_said():
    text = plant_dbc([Port("V", "V")], OUTPUTS)
    with pytest.raises(UnknownNameError, match=r"'thetta' .*did you mean theta"):
        make_layouts(text, [Port("thetta", "rad")], where="bus.dbc")
    with pytest.raises(UnitError, match=r"variable 'theta'.*correct the signal's unit"):
        make_layouts(text, [Port("theta", "kg")])
    with pytest.raises(FormatError, match="not a DBC"):
        parse_dbc("BO_ what", where="x.dbc")
    with pytest.raises(FormatError, match="no message"):
        parse_dbc('VERSION ""\n', where="x.dbc")
    with pytest.raises(BusError, match="cannot be read"):
        read_dbc(Path("nowhere.dbc"))
    with pytest.raises(UnknownNameError):
        bundled_dbc("Twinproof.Plants.Nothing")


def test_trouble_is_counted():
    (layout,) = make_layouts(ports=[Port("theta", "rad")])
    packer, unpacker = Packer(layout), Unpacker([layout])
    frames = [packer.pack({"theta": 0.1 * k}) for k in range(8)]
    damaged = can.Message(
        arbitration_id=frames[5].arbitration_id, is_extended_id=False, data=frames[5].data
    )
    damaged.data[4] ^= 0x10
    short = can.Message(
        arbitration_id=frames[0].arbitration_id, is_extended_id=False, data=frames[0].data[:5]
    )
    stranger = can.Message(arbitration_id=0x7FF, is_extended_id=False, data=b"")
    error = can.Message(is_error_frame=True)
    received = [frames[0], frames[1], frames[1], frames[4], frames[3], damaged, short]
    values = [unpacker.unpack(f) for f in (*received, stranger, error)]
    assert [bool(v and v.values) for v in values] == [True, True, False, True, *([False] * 5)]
    counts = unpacker.statistics
    assert counts == Statistics(
        received=8,
        error_frames=1,
        unknown=1,
        too_short=1,
        wrong_checksum=1,
        lost=2,
        repeated=1,
        wrong_sequence=1,
    )
    assert counts.dropped == 6


def test_values_that_do_not_fit_are_clipped_and_counted():
    (layout,) = make_layouts(ports=[Port("theta", "rad")])
    packer = Packer(layout)
    reading = Unpacker([layout]).unpack(packer.pack({"theta": 1e9}))
    assert reading.values["theta"] == pytest.approx(838.8607)
    assert packer.clipped == 1
    with pytest.raises(DivergenceError, match="'theta' is nan"):
        packer.pack({"theta": float("nan")})


def test_one_scheduler_keeps_all_periods():
    with (
        open_bus(BusSettings(channel="periods")) as bus,
        open_bus(BusSettings(channel="periods")) as listener,
    ):
        counts = Statistics()
        sender = PeriodicSender(sends_to(bus, counts), counts)
        sent: dict[int, list[float]] = {k: [] for k in range(40)}

        def frame(k):
            def make(now):
                sent[k].append(now)
                return can.Message(arbitration_id=k, is_extended_id=False)

            return make

        for k in range(40):
            sender.add(0.001 * (k + 1), frame(k))
        for tick in range(1001):
            sender.send_due(0.001 * tick)
        for k, times in sent.items():
            assert times == pytest.approx([0.001 * (k + 1) * j for j in range(1000 // (k + 1) + 1)])
        assert counts.sent == sum(len(times) for times in sent.values())
        assert counts.late == 0
        got = 0
        while listener.recv(0.0) is not None:
            got += 1
        assert got == counts.sent


def test_a_late_frame_is_counted_and_does_not_push_the_others():
    with open_bus(BusSettings(channel="late")) as bus:
        counts = Statistics()
        sender = PeriodicSender(sends_to(bus, counts), counts)
        times = []
        sender.add(0.010, times.append)
        for now in (0.0, 0.010, 0.047, 0.050, 0.060):
            sender.send_due(now)
        assert times == [0.0, 0.010, 0.047, 0.050, 0.060]
        assert counts.late == 1
        with pytest.raises(BusError):
            sender.add(0.0, lambda now: None)


def test_a_bus_that_is_not_there():
    with pytest.raises(BusError, match=r"slcan.*nowhere"):
        open_bus(BusSettings("slcan", "/dev/nowhere"))
    with pytest.raises(BusError, match="cannot be used"):
        open_bus(BusSettings("telepathy", "x"))
    with pytest.raises(BusError, match="bit rate 7"):
        open_bus(BusSettings("slcan", "/dev/null", bitrate=7))
    with pytest.raises(BusError, match="cannot be opened"):
        open_bus(BusSettings("slcan", "/dev/null"))
    with pytest.raises(BusError, match="cannot be opened"):
        open_bus(BusSettings("socketcan", "nocan0"))


@given(
    st.booleans(),
    st.booleans(),
    st.integers(0, 0x7FF),
    st.binary(max_size=8),
)
def test_a_line_is_the_frame(extended, remote, identifier, data):
    frame = can.Message(
        arbitration_id=identifier,
        is_extended_id=extended,
        is_remote_frame=remote,
        data=b"" if remote else data,
        dlc=len(data),
    )
    assert frame_of(line_of(frame)[:-1], 0.0).equals(frame, timestamp_delta=None)


@pytest.mark.parametrize(
    "line", [b"t12", b"t123", b"t1239001122334455667788", b"txyz0", b"t1232AA"]
)
def test_a_line_that_is_no_frame(line):
    with pytest.raises(ValueError):  # noqa: PT011 - int's and ours
        frame_of(line, 0.0)


@pytest.fixture
def terminals():
    with bridged_terminals() as names:
        yield names


def test_frames_cross_the_bridge_whole_and_in_order(terminals):
    with SlcanBus(terminals[0], bitrate=1_000_000) as one, SlcanBus(terminals[1]) as other:
        sent = [
            can.Message(arbitration_id=k % 2048, is_extended_id=False, data=k.to_bytes(8, "big"))
            for k in range(3000)
        ]
        got = []
        for first in range(0, 3000, 100):
            for frame in sent[first : first + 100]:
                one.send(frame, 5.0)
            while len(got) < first + 100:
                frame = other.recv(5.0)
                assert frame is not None
                got.append(frame)
        assert all(a.equals(b, timestamp_delta=None) for a, b in zip(sent, got, strict=True))
        assert one.malformed == other.malformed == 0
        assert select.select([other.fileno()], [], [], 0)[0] == []


def test_frames_that_are_read_at_once_have_stamps_of_their_own(terminals):
    with SlcanBus(terminals[1]) as bus:
        file = os.open(terminals[0], os.O_WRONLY | os.O_NOCTTY)
        os.write(file, b"t1012AABB\r" * 3)
        stamps = [bus.recv(5.0).timestamp for _ in range(3)]
        os.close(file)
    assert stamps[0] < stamps[1] < stamps[2]


def test_noise_on_the_line_is_counted(terminals):
    with SlcanBus(terminals[1]) as bus:
        file = os.open(terminals[0], os.O_WRONLY | os.O_NOCTTY)
        os.write(file, b"t10")
        os.write(file, b"12AABB\rgarbage\rt1012ZZZZ\r\at1012CCDD\rt" + b"0" * 100)
        frames = [bus.recv(5.0), bus.recv(5.0)]
        assert [bytes(f.data) for f in frames] == [b"\xaa\xbb", b"\xcc\xdd"]
        assert bus.recv(0.2) is None
        os.close(file)
        assert bus.malformed == 4


def test_a_reader_that_is_dead_does_not_stop_the_sender_for_good(terminals):
    with SlcanBus(terminals[0]) as bus:
        began = time.monotonic()
        frame = can.Message(arbitration_id=1, is_extended_id=False, data=bytes(8))
        for _ in range(30_000):
            bus.send(frame, 2.0)
        assert time.monotonic() - began < 30


ECHO = """
import sys
from hil.bus.slcan import SlcanBus
import can
with SlcanBus(sys.argv[1]) as bus:
    print("ready", flush=True)
    while (frame := bus.recv(10.0)) is not None and frame.arbitration_id:
        bus.send(can.Message(arbitration_id=frame.arbitration_id + 1, is_extended_id=False,
                             data=frame.data), 1.0)
"""


def test_round_trip_to_another_process(terminals):
    echo = subprocess.Popen([sys.executable, "-c", ECHO, terminals[1]], stdout=subprocess.PIPE)
    try:
        assert echo.stdout.readline() == b"ready\n"
        with SlcanBus(terminals[0]) as bus:
            for k in range(500):
                bus.send(can.Message(arbitration_id=0x10, is_extended_id=False, data=[k & 0xFF]))
                answer = bus.recv(10.0)
                assert answer is not None
                assert (answer.arbitration_id, answer.data[0]) == (0x11, k & 0xFF)
            bus.send(can.Message(arbitration_id=0, is_extended_id=False))
        assert echo.wait(10) == 0
    finally:
        echo.kill()
        echo.stdout.close()
        echo.wait()


def test_a_log_of_the_bus_is_a_recording(tmp_path):
    found = make_layouts(bundled_dbc("WheeledPendulum").read_text(), [Port("theta_p", "rad")])
    packer = Packer(found[0])
    with can.Logger(tmp_path / "run.blf") as log:
        for k in range(100):
            log(packer.pack({"theta_p": 0.01 * k}, time=1.7e9 + 0.001 * k))
    run = load(
        tmp_path / "run.blf",
        dbc=bundled_dbc("WheeledPendulum"),
        variables={"theta_p": "rad", "omega_p": "rad/s"},
    )
    assert run["theta_p"].values == pytest.approx([0.01 * k for k in range(100)])
    assert run.sample_time == pytest.approx(1e-3, rel=1e-3)
