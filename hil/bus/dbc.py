"""DBC files: made for a plant from its ports, and read for the loop.

A plant's bus has three kinds of messages, each protected end to end and sent every cycle: what the
plant's sensors say (`Sensors1`, …, all outputs), what the controller wants (`Actuators1`, …, all
inputs) and what the controller should follow (`References1`, …, a signal `<output>_ref` for each
output; only sent where a scenario has a reference). Signals are called as the model's variables.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cantools
from cantools.database.can import Database, Message, Node, Signal
from cantools.database.conversion import BaseConversion

from foundation.errors import BusError, FormatError, UnknownNameError
from hil.bus.e2e import PROFILES, Protection

BUNDLED = Path(__file__).parents[1] / "dbc"
"""Folder with one DBC for each plant of the library."""

REFERENCE = "_ref"
"""What follows an output's name in its reference's signal."""

_FIRST_ID = {"Actuators": 0x101, "Sensors": 0x111, "References": 0x121}
"""A lower identifier wins the bus: commands go first."""
_BITS = 24
_PER_MESSAGE = 2
_RESOLUTION = {"m": 1e-6, "m/s": 1e-5}
_USUAL_RESOLUTION = 1e-4
_CYCLE_MS = 1
_ATTRIBUTES = (
    'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;',
    'BA_DEF_ BO_ "E2EProfile" STRING ;',
    'BA_DEF_ BO_ "E2EDataID" INT 0 65535;',
    'BA_DEF_DEF_ "GenMsgCycleTime" 0;',
    'BA_DEF_DEF_ "E2EProfile" "";',
    'BA_DEF_DEF_ "E2EDataID" 0;',
)


@dataclass(frozen=True)
class Port:
    """An input or an output of a plant.

    Attributes:
        name: Of the model's variable.
        unit: As Modelica writes it.
        description: In a few words.
    """

    name: str
    unit: str = ""
    description: str = ""


def plant_dbc(
    inputs: Sequence[Port],
    outputs: Sequence[Port],
    *,
    profile: str = "P11",
    cycle_ms: int = _CYCLE_MS,
) -> str:
    """Return the text of a DBC file with the messages of a plant's bus.

    Signals have 24 bits, two of them in a frame of 8 bytes beside checksum and counter: steps of
    1e-4 of the unit (positions 1e-6 m, velocities 1e-5 m/s) and a span of ± 8.4e6 steps.

    Args:
        inputs, outputs: Of the plant.
        profile: Of AUTOSAR's end-to-end protection: P01, P05 (one signal a frame) or P11.
        cycle_ms: Period of all messages [ms].

    Raises:
        UnknownNameError: No such profile.
        BusError: P02, whose lists of identifiers are the vehicle maker's.

    Example:
        >>> text = plant_dbc([Port("V", "V")], [Port("theta", "rad"), Port("omega")])
        >>> database = parse_dbc(text)
        >>> [(m.name, [s.name for s in m.signals]) for m in database.messages][0]
        ('Actuators1', ['Actuators1_Checksum', 'Actuators1_Counter', 'V'])
    """
    if profile not in PROFILES:
        raise UnknownNameError("E2E profile", profile, PROFILES)
    if profile == "P02":
        raise BusError("profile P02 needs a list of identifiers", remedy="use P11, P01 or P05")
    references = [Port(p.name + REFERENCE, p.unit, f"Reference of {p.name}") for p in outputs]
    groups = (
        ("Actuators", inputs, "Controller", "Plant"),
        ("Sensors", outputs, "Plant", "Controller"),
        ("References", references, "Plant", "Controller"),
    )
    messages: list[Message] = []
    for group, ports, sender, receiver in groups:
        size = min(_PER_MESSAGE, (64 - 8 * PROFILES[profile].header) // _BITS)
        for first in range(0, len(ports), size):
            number = first // size
            messages.append(
                _message(
                    f"{group}{number + 1}",
                    _FIRST_ID[group] + number,
                    ports[first : first + size],
                    (sender, receiver),
                    profile,
                )
            )
    database = Database(messages, nodes=[Node("Plant", ""), Node("Controller", "")], version="1")
    text = database.as_dbc_string().replace("\r\n", "\n").rstrip("\n")
    lines: list[str] = list(_ATTRIBUTES)
    for m in messages:
        lines.append(f'BA_ "GenMsgCycleTime" BO_ {m.frame_id} {cycle_ms};')
        lines.append(f'BA_ "E2EProfile" BO_ {m.frame_id} "{profile}";')
        lines.append(f'BA_ "E2EDataID" BO_ {m.frame_id} {m.frame_id};')
    return "\n".join((text, *lines, ""))


def bundled_dbc(plant: str) -> Path:
    """Return the DBC of a plant of the library.

    Raises:
        UnknownNameError: The plant is not one of the library's.

    Example:
        >>> bundled_dbc("Twinproof.Plants.WheeledPendulum").name
        'WheeledPendulum.dbc'
    """
    path = BUNDLED / f"{plant.rpartition('.')[2]}.dbc"
    if not path.is_file():
        known = [p.stem for p in sorted(BUNDLED.glob("*.dbc"))]
        raise UnknownNameError("bundled DBC", path.stem, known)
    return path


def read_dbc(path: Path) -> Database:
    """Read a DBC file.

    Raises:
        BusError: There is no such file.
        FormatError: It is not a DBC, or describes no message.
    """
    try:
        text = path.read_text(encoding="cp1252", errors="replace")
    except OSError as error:
        raise BusError(
            f"the DBC file cannot be read: {error.strerror}",
            where=str(path),
            remedy="correct bus.dbc",
        ) from error
    return parse_dbc(text, where=str(path))


def parse_dbc(text: str, *, where: str = "") -> Database:
    """Read the text of a DBC file.

    Raises:
        FormatError: It is not a DBC, or describes no message.
    """
    try:
        # Not strict: signals that overlap are common in real files.
        database = cantools.database.load_string(text, database_format="dbc", strict=False)
    except Exception as error:  # parser, number and text errors of three libraries
        raise FormatError(
            f"not a DBC file: {' '.join(str(error).split())}",
            where=where,
            remedy="repair the line, or export the DBC again",
        ) from error
    if not isinstance(database, Database) or not database.messages:
        raise FormatError(
            "the DBC describes no message", where=where, remedy="is it the right file?"
        )
    return database


def protection_of(message: Message) -> Protection | None:
    """Return how a message is protected, by its attributes; None: it is not.

    The attributes are `E2EProfile` (P01, P02, P05, P11), `E2EDataID`, and for P02 `E2EDataIDList`.

    Raises:
        UnknownNameError: A profile that is not supported.
        BusError: P02 without a list of 16 bytes.
    """
    found = _attributes(message)
    profile = str(found.get("E2EProfile", ""))
    if profile in ("", "none"):
        return None
    ids = str(found.get("E2EDataIDList", ""))
    try:
        listed = bytes.fromhex(ids)
    except ValueError as error:
        raise BusError(
            f"'{ids}' is no list of bytes",
            where=f"message {message.name}, attribute E2EDataIDList",
            remedy="write 32 hexadecimal digits",
        ) from error
    return Protection.of(profile, int(found.get("E2EDataID", message.frame_id)), listed)


def _attributes(message: Message) -> Mapping[str, Any]:
    if message.dbc is None:
        return {}
    return {name: attribute.value for name, attribute in message.dbc.attributes.items()}


def _message(
    name: str,
    frame_id: int,
    ports: Sequence[Port],
    nodes: tuple[str, str],
    profile: str,
) -> Message:
    sender, receiver = nodes
    layout = PROFILES[profile]
    signals = [
        Signal(f"{name}_Checksum", 0, layout.checksum_bits, receivers=[receiver]),
        Signal(f"{name}_Counter", layout.checksum_bits, layout.counter_bits, receivers=[receiver]),
    ]
    for place, port in enumerate(ports):
        step = _RESOLUTION.get(port.unit, _USUAL_RESOLUTION)
        top = (1 << (_BITS - 1)) - 1
        signals.append(
            Signal(
                port.name,
                8 * layout.header + _BITS * place,
                _BITS,
                is_signed=True,
                conversion=BaseConversion.factory(scale=step, offset=0),
                minimum=round(-step * top, 9),
                maximum=round(step * top, 9),
                unit=port.unit or None,
                receivers=[receiver],
                comment=port.description or None,
            )
        )
    return Message(frame_id, name, 8, signals, senders=[sender])
