"""Vector's .asc and PEAK's .trc: the dialects there are, and what is not a frame."""

import numpy as np
import pytest

from foundation.errors import FormatError
from recordings import load_signals

DBC = """VERSION ""
BU_: X
BO_ 256 Near: 2 X
 SG_ q : 0|16@1- (1,0) [0|0] "m" X
BO_ 2147484160 Far: 2 X
 SG_ w : 0|16@1- (1,0) [0|0] "m" X
BO_ 768 Fd: 12 X
 SG_ z : 80|16@1- (1,0) [0|0] "m" X
"""


@pytest.fixture
def read(tmp_path):
    dbc = tmp_path / "bus.dbc"
    dbc.write_text(DBC)

    def reader(suffix, text):
        path = tmp_path / f"run{suffix}"
        path.write_text(text)
        return load_signals(path, dbc=dbc)

    return reader


HEAD = "base hex  timestamps absolute\ninternal events logged\n"
ASC = """date Sun Sep 12 03:35:14.717 am 2021
base hex  timestamps absolute
internal events logged
// version 9.0.0
Begin Triggerblock Sun Sep 12 03:35:14.717 am 2021
   0.000000 Start of measurement
   0.015991 1  100             Rx   d 2 05 00  Length = 0 BitCount = 0 ID = 256
   0.016000 CAN 1 Status:chip status error active
   0.017000 2  100             Rx   d 2 07 00
   0.020000 1  200x            Tx   d 2 FF FF
   0.021000 1  100             Rx   r 2
   0.022000 1  ErrorFrame
   0.025991 1  100             Rx   d 2 06 00
   0.027000 2  100             Rx   d 2 08 00
   0.030000 1  200x            Tx   d 2 FE FF
   0.031000 CANFD   1 Rx    300  Symbol  1 0 9 12 00 00 00 00 00 00 00 00 00 00 09 00  0 0 1000 0
   0.041000 CANFD   1 Rx    300          1 0 9 12 00 00 00 00 00 00 00 00 00 00 0A 00  0 0 1000 0
   0.050000 1  Statistic: D 1 R 0 XD 0 XR 0 E 0 O 0 B 0.00%
something else
End TriggerBlock
"""


def test_asc(read, tmp_path):
    mapping = tmp_path / "map.toml"
    mapping.write_text("[channels.q]\nbus = 1")
    path = tmp_path / "run.asc"
    path.write_text(ASC)
    found = load_signals(path, dbc=tmp_path / "bus.dbc", channel_map=mapping)
    assert found["q"].values.tolist() == [5, 6]
    np.testing.assert_allclose(found["q"].time, [0, 0.01], atol=1e-12)
    assert found["w"].values.tolist() == [-1, -2]
    assert found["z"].values.tolist() == [9, 10]
    notes = " ".join(found.notes)
    assert "1 error frames left out" in notes
    assert "1 remote frames left out" in notes
    assert "lines of the log are no frames" in notes


def test_asc_with_decimal_numbers(read):
    found = read(
        ".asc",
        HEAD.replace("hex", "dec") + "0.1 1 256 Rx d 2 10 00\n0.2 1 256 Rx d 2 11 00\n",
    )
    assert found["q"].values.tolist() == [10, 11]


def test_asc_with_relative_stamps_is_refused(read):
    with pytest.raises(FormatError, match=r"counts from the line before.*absolute"):
        read(
            ".asc",
            HEAD.replace("absolute", "relative")
            + "0.1 1 100 Rx d 2 10 00\n0.2 1 100 Rx d 2 11 00\n",
        )


TRC = {
    "1.0": ";comment\n    1)     2.5  0100  2  05 00\n    2)  12.5  00000200  2  FF FF\n"
    "    3)  22.5  0100  2  06 00\n    4) 32.5 00000200  2  FE FF\n",
    "1.1": ";$FILEVERSION=1.1\n;$STARTTIME=40000.5\n"
    "    1)   2.5  Rx  0100  2  05 00\n    2)  12.5  Tx  00000200  2  FF FF\n"
    "    3)  22.5  Rx  0100  2  06 00\n    4)  32.5  Rx  00000200  2  FE FF\n"
    "    5)  33.5  Warng FFFFFFFF  4  00 00 00 08  BUSHEAVY\n",
    "1.3": ";$FILEVERSION=1.3\n;$STARTTIME=40000.5\n"
    "    1)   2.5 1 Rx  0100 - 2  05 00\n    2)  12.5 1 Tx  00000200 - 2  FF FF\n"
    "    3)  22.5 1 Rx  0100 - 2  06 00\n    4)  32.5 1 Rx  00000200 - 2  FE FF\n",
    "2.0": ";$FILEVERSION=2.0\n;$STARTTIME=40000.5\n;$COLUMNS=N,O,T,I,d,l,D\n"
    "  1  2.5 DT 0100 Rx 2 05 00\n  2 12.5 DT 00000200 Rx 2 FF FF\n"
    "  3 22.5 DT 0100 Rx 2 06 00\n  4 32.5 DT 00000200 Rx 2 FE FF\n",
    "2.1": ";$FILEVERSION=2.1\n;$STARTTIME=40000.5\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n"
    "  1  2.5 DT 1 0100 Rx - 2 05 00\n  2 12.5 DT 1 00000200 Rx - 2 FF FF\n"
    "  3 22.5 DT 1 0100 Rx - 2 06 00\n  4 32.5 DT 1 00000200 Rx - 2 FE FF\n"
    "  5 33.5 RR 1 0100 Rx - 2\n",
}


@pytest.mark.parametrize("version", TRC)
def test_trc(read, version):
    found = read(".trc", TRC[version])
    assert found["q"].values.tolist() == [5, 6]
    assert found["w"].values.tolist() == [-1, -2]
    np.testing.assert_allclose(found["w"].time, [0.01, 0.03], atol=2e-6)
    assert ("1 lines of the log are no frames" in found.notes) == (version == "1.1")
    assert ("1 remote frames left out" in found.notes) == (version == "2.1")


@pytest.mark.parametrize(
    ("suffix", "text", "pattern"),
    [
        (".asc", HEAD + "0.1 1 100 Rx d 2 10 00\n0.2 1 100 Rx d 2 1G 00\n", r"run\.asc, line 4"),
        (".asc", HEAD + "0.1 1 FFFFFFFFFx Rx d 2 10 00\n", r"identifier FFFFFFFFF.*line 3"),
        (".asc", "hello\n", "no frame in the log"),
        (".asc", "", "no frame in the log"),
        (".trc", TRC["1.1"].replace("06 00", "06 0x"), r"run\.trc, line 5"),
        (".trc", TRC["1.1"].replace("22.5", "1e999"), r"run\.trc, line 5"),
        (".trc", ";$FILEVERSION=2.0\n 1 2.5 DT 0100 Rx 2 05 00\n", r"no column information"),
        (".asc", "0.1 1 100 Rx d 2 " + "00 " * 9000, "more than 10000 characters"),
    ],
)
def test_bad_lines_name_their_place(read, suffix, text, pattern):
    with pytest.raises(FormatError, match=pattern) as caught:
        read(suffix, text)
    assert caught.value.remedy


def test_half_a_byte_at_the_end_is_not_taken_for_one(read):
    whole = HEAD + "0.1 1 100 Rx d 2 10 00\n0.2 1 100 Rx d 2 11 00\n0.3 1 100 Rx d 2 12 01\n"
    found = read(".asc", whole[:-2])
    assert found["q"].values.tolist() == [0x10, 0x11]
    assert "1 lines of the log are no frames" in found.notes
