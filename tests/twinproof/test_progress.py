"""Progress: an estimate when there is a basis for one, and only where somebody looks."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from foundation.progress import Spoken, about

_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0}
_LEFT = re.compile(r"about ([\d.]+) (s|min|h) left")


def told(seconds_a_piece: float, total: int, before: int = 0) -> Iterator[tuple[int, str]]:
    """Yield (pieces done, what is said) of work at a constant rate."""
    clock = [0.0]
    said: list[str] = []
    spoken = Spoken(said.append, lambda: clock[0])
    for done in range(before, total + 1):
        clock[0] = (done - before) * seconds_a_piece
        spoken("working", done, total)
        yield done, said[-1]


@given(st.floats(1e-3, 600.0), st.integers(1, 300), st.integers(0, 200).filter(lambda n: n < 300))
def test_steady_work_is_estimated_right_and_never_without_a_basis(
    seconds: float, more: int, before: int
) -> None:
    total = before + more
    for done, text in told(seconds, total, before):
        found = _LEFT.search(text)
        fresh = done - before
        assert (found is None) == (done == total or fresh < 2 or fresh * seconds < 2.0), text
        if found is not None:
            truth = (total - done) * seconds
            # One digit or so: the rounding is a second, five, a minute, five.
            assert float(found[1]) * _SECONDS[found[2]] == pytest.approx(truth, rel=0.5, abs=1.0)


def test_another_stage_begins_anew() -> None:
    clock = [0.0]
    said: list[str] = []
    spoken = Spoken(said.append, lambda: clock[0])
    for done in range(5):
        clock[0] += 10.0
        spoken("first", done, 5)
    assert "left" in said[-1]
    spoken("second", 1, 5)
    assert said[-1] == "second (1 of 5)"
    spoken("third")
    assert said[-1] == "third"


@given(st.floats(0.0, 1e5))
def test_a_time_is_never_none(seconds: float) -> None:
    number, unit = about(seconds).removeprefix("about ").split()
    assert float(number) * _SECONDS[unit] > 0


def on_a_terminal(*words: str, folder: Path) -> str:
    """Run a command whose standard error is a terminal; return what it wrote there."""
    main = [sys.executable, "-c", "from twinproof.cli import main; main()"]
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        [*main, *words],
        stdout=subprocess.PIPE,
        stderr=theirs,
        cwd=folder,
        env={**os.environ, "TERM": "xterm", "COLUMNS": "120"},
    ) as process:
        os.close(theirs)
        text = b""
        while True:
            try:
                piece = os.read(ours, 4096)
            except OSError:  # how Linux says that the other end is closed
                break
            if not piece:
                break
            text += piece
        assert process.stdout is not None
        process.stdout.read()
    os.close(ours)
    assert process.returncode == 0, text
    return text.decode()


DESIGN = ("design", "Twinproof.Plants.Pendulum", "--amplitude", "1", "--duration", "5")


def test_a_terminal_sees_how_far_it_is_and_a_program_nothing(tmp_path: Path) -> None:
    seen = on_a_terminal(*DESIGN, folder=tmp_path)
    assert re.search(r"changing the best one \(\d+ of 150", seen)
    assert "of 150" not in on_a_terminal(*DESIGN, "--json", "-", folder=tmp_path)
    main = [sys.executable, "-c", "from twinproof.cli import main; main()"]
    piped = subprocess.run(
        [*main, *DESIGN], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert "of 150" not in piped.stdout + piped.stderr
