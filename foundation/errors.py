"""Every error a user of twinproof can meet, as one tree.

TwinproofError                    anything below; `str()` says what, where and what to try
├── InputError                    the request or its input is wrong               (exit status 2)
│   ├── UnknownNameError          a name that nothing has (class, channel, effect, place, data set)
│   ├── ModelError                something about a model
│   │   ├── ModelicaError         Modelica source that cannot be understood; file:line:column
│   │   ├── UnsupportedModelError right Modelica, but outside what the tool can translate or use
│   │   └── FmuError              an FMU that is malformed, does not load or fails while running
│   ├── RecordingError            something about a recording
│   │   ├── FormatError           a file that is empty, truncated or not what its name says
│   │   ├── TimeError             time that is missing, not increasing or not finite
│   │   ├── ChannelError          a channel that is missing, not finite or mapped wrongly
│   │   └── UnitError             units that are unknown or cannot be converted
│   ├── BusError                  a CAN bus that is absent or refuses, a DBC that does not fit it
│   ├── ExcitationError           the recording cannot answer the question (too short, too quiet)
│   └── StoreError                the service's database: gone, full, or of another version
└── ComputationError              right input, no answer                          (exit status 3)
    ├── DivergenceError           a simulation or a fit left the finite numbers
    └── CompilerError             no C compiler, or it refused what we generated
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class TwinproofError(Exception):
    """Base of all errors raised on purpose.

    Args:
        what: What is wrong, in one clause.
        where: Where: `file:line:column`, channel and time, row, frame.
        remedy: What to try.

    Example:
        >>> str(TwinproofError("no channel 'q'", where="run.csv", remedy="name one in --map"))
        "no channel 'q' (run.csv); name one in --map"
    """

    exit_status = 3

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        super().__init__(what)
        self.what = what
        self.where = where
        self.remedy = remedy

    def __str__(self) -> str:
        text = f"{self.what} ({self.where})" if self.where else self.what
        return f"{text}; {self.remedy}" if self.remedy else text


class InputError(TwinproofError, ValueError):
    """The request or its input is wrong. Raised for example for an option out of range."""

    exit_status = 2


class UnknownNameError(InputError, LookupError):
    """A name that nothing has. The remedy offers the nearest names there are."""

    def __init__(self, kind: str, name: str, known: Iterable[str], *, where: str = "") -> None:
        names = list(known)
        near = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
        if near:
            remedy = f"did you mean {' or '.join(near)}?"
        elif names:
            shown = ", ".join(names[:12]) + (", …" if len(names) > 12 else "")
            remedy = f"there are: {shown}"
        else:
            remedy = f"there is no {kind} at all"
        super().__init__(f"unknown {kind} '{name}'", where=where, remedy=remedy)
        self.name = name


class ModelError(InputError):
    """Something about a model is wrong."""


class ModelicaError(ModelError):
    """Modelica source that cannot be understood; `where` is file:line:column."""


class UnsupportedModelError(ModelError):
    """Right Modelica, but outside what the tool can translate or what a method can use."""


class FmuError(ModelError):
    """An FMU that is malformed, does not load, or fails while running."""


class RecordingError(InputError):
    """Something about a recording is wrong."""


class FormatError(RecordingError):
    """A file that is empty, truncated, or not what its name says."""


class TimeError(RecordingError):
    """Time that is missing, not increasing, or not finite."""


class ChannelError(RecordingError):
    """A channel that is missing, not finite, or mapped wrongly."""


class UnitError(RecordingError):
    """Units that are unknown or cannot be converted into one another."""


class BusError(InputError):
    """A CAN bus that is absent, refuses or stays silent, or a DBC that does not fit the plant."""


class ExcitationError(InputError):
    """The recording cannot answer the question: too short, too quiet, or clipped."""


class StoreError(InputError):
    """The service's database is gone, full, or of a version that this program does not know."""


class ComputationError(TwinproofError, RuntimeError):
    """Right input, but no answer was reached."""


class DivergenceError(ComputationError, ArithmeticError):
    """A simulation or a fit left the finite numbers."""


class CompilerError(ComputationError):
    """There is no C compiler, or it refused what we generated."""
