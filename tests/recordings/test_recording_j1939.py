"""J1939: messages known by their group, whoever sends them; values that say that there is none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foundation.errors import ChannelError
from recordings import load, load_signals
from recordings.readers.dbc import parameter_group

DBC = """VERSION ""
BU_: X
BO_ 2364540158 EEC1: 8 X
 SG_ EngineSpeed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" X
 SG_ Torque : 16|8@1+ (1,-125) [-125|125] "%" X
 SG_ Starter : 0|2@1+ (1,0) [0|3] "" X
BO_ 2565537790 Request: 3 X
 SG_ pgn : 0|24@1+ (1,0) [0|0] "" X
BO_ 2147484160 Own: 8 X
 SG_ raw : 0|8@1+ (1,0) [0|0] "" X
BA_DEF_ BO_  "VFrameFormat" ENUM  "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_  "ProtocolType" STRING ;
BA_DEF_DEF_  "VFrameFormat" "ExtendedCAN";
BA_DEF_DEF_  "ProtocolType" "";
BA_ "ProtocolType" "J1939";
BA_ "VFrameFormat" BO_ 2364540158 3;
BA_ "VFrameFormat" BO_ 2565537790 3;
"""


@pytest.fixture
def bus(tmp_path):
    dbc = tmp_path / "truck.dbc"
    dbc.write_text(DBC)

    def write(*frames, text="", loader=load_signals):
        path, mapping = tmp_path / "run.log", tmp_path / "map.toml"
        path.write_text("".join(f"({t:.3f}) can0 {i}#{d}\n" for t, i, d in frames))
        mapping.write_text(text)
        return loader(path, dbc=dbc, channel_map=mapping)

    return write


def eec1(t, speed, torque=125, starter=0, identifier="0CF00400"):
    raw = speed.to_bytes(2, "little").hex()
    return (t, identifier, f"{starter:02x}ff{torque:02x}{raw}ffffff")


def test_priority_and_sender_do_not_count(bus):
    found = bus(*[eec1(k, 8000 + 8 * k, identifier="18F00421") for k in range(4)])
    assert found["EngineSpeed"].values.tolist() == [1000, 1001, 1002, 1003]
    assert found["EngineSpeed"].unit == "rpm"


def test_messages_to_one_receiver_are_one_group(bus):
    frames = [
        (k, f"18EA{to}{sender}", "ECFE00") for k, (to, sender) in enumerate([("FF", "F9")] * 3)
    ]
    assert bus(*frames)["pgn"].values.tolist() == [0xFEEC] * 3
    several = [(k, f"18EA{to}F9", "ECFE00") for k, to in enumerate(["FF", "00", "21"])]
    assert len(bus(*several)["pgn"]) == 3


def test_other_messages_of_the_file_are_known_by_their_whole_identifier(bus):
    found = bus(
        *[(k, "00000200", "05") for k in range(3)], *[(k, "00000201", "07") for k in range(3)]
    )
    assert found["raw"].values.tolist() == [5, 5, 5]
    assert "3 of 6 frames are of messages that the DBC does not describe" in found.notes


def test_error_and_not_available_are_no_values(bus):
    raws = [0, 0xFAFF, 0xFB00, 0xFE00, 0xFF00, 0xFFFF, 800]
    torques = [125, 250, 251, 254, 255, 130, 0]
    starters = [0, 1, 2, 3, 0, 1, 2]
    frames = [eec1(k, *v) for k, v in enumerate(zip(raws, torques, starters, strict=True))]
    found = bus(*frames)
    assert found["EngineSpeed"].values.tolist() == [0, 0xFAFF * 0.125, 100]
    assert found["EngineSpeed"].time.tolist() == [0, 1, 6]
    assert found["Torque"].values.tolist() == [0, 125, 5, -125]
    assert found["Starter"].values.tolist() == [0, 1, 0, 1]
    assert "4 values of 'EngineSpeed' say that there is none" in found.notes


def test_several_senders_need_an_address(bus):
    frames = [
        eec1(k + s / 10, 800 * (s + 1), identifier=f"0CF004{s:02X}")
        for k in range(3)
        for s in (0, 3)
    ]
    with pytest.raises(ChannelError, match=r"several addresses \(0, 3\).*address = 0"):
        bus(*frames)
    key = "[channels.EngineSpeed]\naddress = {}\n[channels.Torque]\naddress = 0\n"
    key += "[channels.Starter]\naddress = 0"
    assert bus(*frames, text=key.format(3))["EngineSpeed"].values.tolist() == [400] * 3
    assert bus(*frames, text=key.format(0))["EngineSpeed"].values.tolist() == [100] * 3
    with pytest.raises(ChannelError, match=r"from address 7.*there are: 0, 3"):
        bus(*frames, text=key.format(7))


def test_a_recording_of_it(bus):
    run = bus(*[eec1(k / 100, 8000 + k) for k in range(50)], loader=load)
    np.testing.assert_allclose(run["EngineSpeed"].values, 1000 + np.arange(50) / 8)
    assert run["EngineSpeed"].sensor.resolution == 0.125


@given(st.integers(0, (1 << 29) - 1))
def test_groups_follow_the_standard(identifier):
    # SAE J1939-21, 5.1.2: a format below 240 has a destination where others extend the group.
    bits = f"{identifier:029b}"
    pages, form, specific = bits[3:5], bits[5:13], bits[13:21]
    extension = specific if int(form, 2) >= 240 else "00000000"
    assert parameter_group(identifier) == int(pages + form + extension, 2)
