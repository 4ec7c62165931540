"""A handful of kills; the benchmark does more (`python -m benchmarks twin`)."""

from benchmarks.twin.kills import Kills, kill, look


def test_a_killed_service_loses_nothing_and_opens_for_nothing():
    found = kill(3, seed=2, longest=5.0)
    assert found.count == 3
    assert found.lost == found.broken == found.torn == found.wrongly_open == 0
    # A busy machine is late with more than a tenth of a second; the benchmark has the figure.
    assert found.unrecorded < 1.0
    assert found.looks > 20
    assert found.promotions >= 1


def test_what_is_counted_as_wrongly_open():
    found = Kills()
    look(found, ["1", "0.185", "0.19", "100"], doubted=False)
    look(found, ["0", "0.185", "0.28", "100"], doubted=True)
    look(found, ["1", "0.185", "0.28", "1"], doubted=False)
    assert (found.looks, found.open_looks, found.wrongly_open) == (3, 2, 0)
    look(found, ["1", "0.185", "0.28", "9"], doubted=False)
    look(found, ["1", "0.185", "0.19", "9"], doubted=True)
    assert found.wrongly_open == 2
