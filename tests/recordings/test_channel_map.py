"""Channel maps: what they say, and what is refused with its place."""

import pytest

from foundation.errors import ChannelError, FormatError, RecordingError
from recordings import ChannelSource, Kind, Sensor, TimeSource, parse_map, read_map


def test_a_full_map():
    mapping = parse_map(
        '[channels.q]\nsource = "qm"\nunit = "mm"\nsd = 1e-4\nresolution = 1e-5\ndelay = 1\n'
        '[time]\nsource = "t"\nunit = "ms"'
    )
    assert mapping.channels == {"q": ChannelSource("qm", "mm", Sensor(1e-4, 1e-5, 1.0))}
    assert mapping.time == TimeSource("t", "ms")


def test_what_makes_a_channel_of_a_signal():
    mapping = parse_map(
        '[channels.q]\nfactor = -1\noffset = -0.02\nkind = "command"\nbus = 1\naddress = 0x21\n'
        '[channels.p]\nbus = "can1"\n[time]\nstep = 0.01\nclock = "software"'
    )
    q = mapping.channels["q"]
    assert (q.factor, q.offset, q.kind, q.bus, q.address) == (-1, -0.02, Kind.COMMAND, "1", 0x21)
    assert mapping.channels["p"].bus == "can1"
    assert mapping.time == TimeSource(step=0.01, software_clock=True)
    assert not parse_map('[time]\nclock = "hardware"').time.software_clock


def test_a_later_map_adds_keys():
    first = parse_map('[channels.q]\nfactor = -1\nkind = "state"')
    both = first.updated(parse_map("[channels.q]\noffset = 2\nfactor = 3")).channels["q"]
    assert (both.factor, both.offset, both.kind) == (3, 2, Kind.STATE)


def test_everything_may_be_left_out():
    assert parse_map("[channels.q]").channels == {"q": ChannelSource(None, None, Sensor())}
    assert parse_map("").time == TimeSource("time", "s", None)


def test_a_later_map_wins_where_it_speaks():
    first = parse_map('[channels.a]\nsource = "x"\nsd = 1\n[channels.b]\n[time]\nsource = "t"')
    both = first.updated(parse_map('[channels.a]\nsource = "y"\nunit = "m"'))
    assert both.channels == {"a": ChannelSource("y", "m", Sensor(1.0)), "b": ChannelSource()}
    noisy = first.updated(parse_map("[channels.a]\nresolution = 2\ndelay = 3"))
    assert noisy.channels["a"] == ChannelSource("x", None, Sensor(1.0, 2.0, 3.0))
    assert both.time.source == "t"
    assert first.updated(parse_map("[time]\nstep = 0.1")).time.step == 0.1


@pytest.mark.parametrize(
    ("text", "error", "fragments"),
    [
        ("[channels.q", FormatError, ["not TOML", "end of document"]),
        ("[channels.q]\nsource = qm", FormatError, ["not TOML", "line 2"]),
        ("[channels.q]\n[channels.q]", FormatError, ["line 2"]),
        ("[chanels.q]", ChannelError, ["unknown table 'chanels'", "did you mean channels?"]),
        ("[channels.q]\nsorce = 'a'", ChannelError, ["[channels.q]", "'sorce'", "mean source?"]),
        ("[time]\nsteps = 1", ChannelError, ["[time]", "'steps'", "did you mean step?"]),
        ("channels = 1", ChannelError, ["'channels' is not a table"]),
        ("[channels]\nq = 'qm'", ChannelError, ["'channels.q' is not a table"]),
        ("[channels.q]\nsource = 3", ChannelError, ["[channels.q]", "'source'", "quotes"]),
        ("[channels.q]\nsd = 'small'", ChannelError, ["'sd' is 'small'", "SI unit"]),
        ("[channels.q]\nsd = -1", ChannelError, ["'sd' is -1", "not negative"]),
        ("[channels.q]\ndelay = nan", ChannelError, ["'delay' is nan"]),
        ("[channels.q]\nresolution = true", ChannelError, ["'resolution' is True"]),
        ("[channels.q]\nfactor = 0", ChannelError, ["'factor' is 0", "leave the channel out"]),
        ("[channels.q]\nfactor = inf", ChannelError, ["'factor' is inf", "finite number"]),
        ("[channels.q]\nkind = 'input'", ChannelError, ["'kind' is 'input'", "command, state"]),
        ("[channels.q]\nkind = 1", ChannelError, ["'kind' is not a text"]),
        ("[channels.q]\nbus = 1.5", ChannelError, ["'bus' is not a text"]),
        ("[channels.q]\naddress = 300", ChannelError, ["'address' is 300", "0 to 253"]),
        ("[time]\nclock = 'atomic'", ChannelError, ["[time]", "'atomic'", "hardware, software"]),
        ("[time]\nstep = 0", ChannelError, ["'step'", "above 0"]),
        ("[time]\nstep = 1\nsource = 't'", ChannelError, ["'step'", "without a time column"]),
    ],
)
def test_mistakes_name_their_place(tmp_path, text, error, fragments):
    path = tmp_path / "map.toml"
    path.write_text(text)
    with pytest.raises(error) as caught:
        read_map(path)
    message = str(caught.value)
    assert caught.value.remedy
    assert all(fragment in message for fragment in ["map.toml", *fragments])


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(RecordingError, match=r"cannot be read: No such file .*--map"):
        read_map(tmp_path / "none.toml")
    (tmp_path / "latin.toml").write_bytes("[channels.q]\nunit = '°'".encode("latin-1"))
    with pytest.raises(FormatError, match=r"byte 21.*UTF-8"):
        read_map(tmp_path / "latin.toml")
