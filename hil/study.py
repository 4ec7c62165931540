"""A what-if study in TOML: controllers × plants × references × disturbances, and what must hold.

    name = "robust"
    [plant]
    model = "Twinproof.Plants.WheeledPendulum"
    parameters_from = "fit.json"            # of `identify --json`
    [plants]
    draws = 50                              # from the fit's covariance
    effects = ["CoulombFriction@wheel,tau_c=25"]   # each is one plant more, beside none
    [plants.ranges]
    theta_p_start = ["-5 deg", "5 deg"]     # uniform
    [controllers.pid]
    kind = "pid"
    …
    [references.slow.theta_p]
    kind = "sines"
    …
    [disturbances.pushes.V]
    kind = "noise"
    …
    [[criteria]]
    …
    [margins]
    gain_db = 6.0
    phase_deg = 30.0
    disk = 0.5
    [run]
    duration = 5.0
    seed = 1

The same plants, noise and disturbances meet every controller, so that controllers are compared in
pairs. Every run follows from the study's seed and its own number.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from fmus.package import cached_fmu
from fmus.running import model_fmu
from fmus.sources import find_source
from foundation.errors import InputError, TwinproofError, UnknownNameError, UnsupportedModelError
from hil.controllers import Controller
from hil.criteria import Criterion, Deadlines, MissedFrames, SafeState, Verdict
from hil.margins import Margins
from hil.plants import Fit, PlantSettings, from_here, plant_of
from hil.scenario import controller_of, criterion_of
from hil.settings import Table, build, number, read_toml, unit
from hil.waveforms import Waveform, waveform_of
from identification.discovery.extension import extend, parse_addition

Array: TypeAlias = npt.NDArray[np.float64]

_KEYS = (
    *("name", "plant", "plants", "controllers", "references", "disturbances"),
    *("criteria", "margins", "run"),
)
NONE = "none"
"""Name of the reference, the disturbance or the effect that is absent."""


@dataclass(frozen=True, kw_only=True)
class StudyRun:
    """How each run goes.

    Attributes:
        duration: [s].
        step: Of a cycle [s].
        seed: Of everything.
        confidence: Of the intervals of pass rates.

    Raises:
        InputError: Numbers that make no sense.
    """

    duration: float = unit("s", 10.0)
    step: float = unit("s", 1e-3)
    seed: int = 1
    confidence: float = 0.95

    def __post_init__(self) -> None:
        if not 0 < self.step <= self.duration or not 0 < self.confidence < 1:
            raise InputError(
                f"a step of {self.step:g} s in {self.duration:g} s, confidence {self.confidence:g}",
                where="run",
                remedy="choose a positive step within the run, a confidence between 0 and 1",
            )

    @property
    def cycles(self) -> int:
        """How many."""
        return round(self.duration / self.step)


@dataclass(frozen=True, kw_only=True)
class MarginLimits:
    """What the margins must be at least; None: that one does not matter.

    Attributes:
        gain_db: Gain margin [dB].
        phase_deg: Phase margin [deg].
        disk: Disk margin.
    """

    gain_db: float | None = None
    phase_deg: float | None = None
    disk: float | None = None

    def judge(self, found: Margins) -> list[Verdict]:
        """Return a verdict for each margin that matters."""
        values = {
            "gain margin": (20 * math.log10(found.gain), self.gain_db, "dB"),
            "phase margin": (math.degrees(found.phase), self.phase_deg, "deg"),
            "disk margin": (found.disk, self.disk, ""),
        }
        return [
            Verdict(
                name,
                "margin",
                found.is_stable and value >= limit,
                value,
                limit,
                f"{value:.3g} {unit_}".strip() if found.is_stable else "unstable",
            )
            for name, (value, limit, unit_) in values.items()
            if limit is not None
        ]


@dataclass(frozen=True, eq=False)
class Variant:
    """A plant's physics: as it is, or with an effect added.

    Attributes:
        name: `none`, or the effect as the study writes it.
        fmu: Of it.
    """

    name: str
    fmu: Path


@dataclass(frozen=True)
class Case:
    """One run of a study.

    Attributes:
        number: Its number.
        controller, variant, reference, disturbance: Names.
        draw: Number of the plant's draw.
        world: Number of what it meets, the same for every controller: seed of noise and
            disturbance.
    """

    number: int
    controller: str
    variant: str
    reference: str
    disturbance: str
    draw: int
    world: int


@dataclass(frozen=True, eq=False)
class Study:
    """A study, read and checked.

    Attributes:
        name, path: Of the study and its file.
        table: As read, for the workers.
        plant: Before draws and effects.
        variants: Plants by effect.
        draws: Of parameters, for each variant.
        ranges: Parameter → (low, high).
        controllers: Name → table.
        references, disturbances: Name → variable → waveform.
        criteria, margin_limits, run: As the file says.
        operating_point: For the margins.
        key: Changes with everything that matters for results.

    Example:
        >>> import tempfile
        >>> text = '''
        ... [plant]
        ... model = "Twinproof.Plants.Pendulum"
        ... [plants]
        ... draws = 3
        ... [plants.ranges]
        ... mgl = [3.0, 4.5]
        ... [controllers.stiff]
        ... kind = "pid"
        ... measured = ["theta"]
        ... commanded = ["tau"]
        ... period = "5 ms"
        ... proportional = 20.0
        ... [references.still]
        ... [[criteria]]
        ... kind = "limit"
        ... signal = "theta"
        ... high = "10 deg"
        ... [run]
        ... duration = 1.0
        ... '''
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "still.toml"
        ...     _ = path.write_text(text)
        ...     study = read_study(path)
        >>> [case.number for case in study.cases()]
        [0, 1, 2]
        >>> 3.0 <= study.parameters(draw=1)["mgl"] <= 4.5
        True
        >>> type(study.make_controller("stiff")).__name__
        'PID'
    """

    name: str
    path: Path
    table: Table
    plant: PlantSettings
    variants: tuple[Variant, ...]
    draws: int
    ranges: Mapping[str, tuple[float, float]]
    controllers: Mapping[str, Table]
    references: Mapping[str, Mapping[str, Waveform]]
    disturbances: Mapping[str, Mapping[str, Waveform]]
    criteria: tuple[Criterion, ...]
    margin_limits: MarginLimits | None
    run: StudyRun
    operating_point: Mapping[str, float] = field(default_factory=dict[str, float])
    key: str = ""

    def cases(self) -> list[Case]:
        """Return all runs."""
        found: list[Case] = []
        for controller in self.controllers:
            world = 0
            for variant in self.variants:
                for draw in range(self.draws):
                    for reference in self.references:
                        for disturbance in self.disturbances:
                            found.append(
                                Case(
                                    len(found),
                                    controller,
                                    variant.name,
                                    reference,
                                    disturbance,
                                    draw,
                                    world,
                                )
                            )
                            world += 1
        return found

    def parameters(self, draw: int) -> dict[str, float]:
        """Return the plant's parameters in a draw.

        The first draw is the fit itself, the others are drawn from its covariance; parameters with
        a range are drawn from that in all of them. What the study sets itself stays.
        """
        values = dict(self.plant.parameters)
        rng = np.random.default_rng([self.run.seed, 0, draw])
        if self.plant.fit is not None and draw > 0:
            given = {n: v for n, v in values.items() if n not in self.plant.fit.values}
            fixed = self._overridden()
            values = {**self.plant.fit.draw(rng), **given, **fixed}
        return values | {n: float(rng.uniform(*ends)) for n, ends in self.ranges.items()}

    def _overridden(self) -> dict[str, float]:
        own = self.table.sub("plant").sub("parameters").values
        return {n: v for n, v in self.plant.parameters.items() if n in own}

    def make_controller(self, name: str) -> Controller:
        """Return a controller of the study."""
        make, _ = controller_of(self.controllers[name], self.plant)
        assert make is not None
        return make()


def read_study(path: Path, *, roots: tuple[Path, ...] = ()) -> Study:
    """Read a study.

    Raises:
        InputError: The file is missing, or says something that cannot be; says where.
    """
    return study_of(read_toml(path), roots)


def study_of(table: Table, roots: tuple[Path, ...] = ()) -> Study:
    """Return the study that a table describes; errors as `read_study`."""
    table.only(_KEYS)
    plant = plant_of(table.sub("plant"), roots)
    run = build(StudyRun, table.sub("run"))
    outputs = {p.name: p.unit for p in plant.outputs}
    inputs = {p.name: p.unit for p in plant.inputs}
    plants = table.sub("plants")
    plants.only(["draws", "effects", "ranges"])
    draws = plants.values.get("draws", 1)
    if not isinstance(draws, int) or isinstance(draws, bool) or draws < 1:
        raise InputError(
            f"{draws!r} draws", where=plants.where("draws"), remedy="give a number of 1 or more"
        )
    references = _groups(table.sub("references"), outputs, "output")
    controllers = _controllers(table.sub("controllers"), plant, run.step)
    margins_table = table.sub("margins")
    point = margins_table.sub("operating_point")
    columns = [*outputs, *inputs, *(f"command.{n}" for n in inputs)]
    always = set.intersection(*(set(group) for group in references.values()))
    columns += [f"reference.{n}" for n in sorted(always)]
    study = Study(
        name=str(table.values.get("name", table.path.stem)),
        path=table.path,
        table=table,
        plant=plant,
        variants=_variants(plants, plant, roots),
        draws=draws,
        ranges=_ranges(plants.sub("ranges"), plant),
        controllers=controllers,
        references=references,
        disturbances=_groups(table.sub("disturbances"), inputs, "input"),
        criteria=tuple(
            _offline(criterion_of(t, columns, plant, run.duration), t)
            for t in table.subs("criteria")
        ),
        margin_limits=(
            build(MarginLimits, margins_table.without("operating_point"))
            if "margins" in table.values
            else None
        ),
        run=run,
        operating_point={
            n: number(v, plant.unit(n), point.where(n)) for n, v in point.values.items()
        },
    )
    if not study.criteria and study.margin_limits is None:
        raise InputError(
            "the study has nothing that must hold",
            where=table.where(),
            remedy="add [[criteria]] or [margins]",
        )
    return replace(study, key=_key(study))


def with_fit(study: Study, fit: Fit) -> Study:
    """Return the same study of a plant with other parameters.

    What the study sets itself under `[plant.parameters]` stays.

    Raises:
        UnknownNameError: The plant has no such parameter.
    """
    plant = study.plant
    known = plant.described.names
    for name in fit.values:
        if name not in known:
            listed = [v.name for v in plant.described.parameters]
            raise UnknownNameError("parameter", name, listed, where=str(study.path))
    own = study.table.sub("plant").sub("parameters").values
    kept = {n: v for n, v in plant.parameters.items() if n in own}
    plant = replace(plant, fit=fit, parameters={**fit.values, **kept})
    changed = replace(study, plant=plant)
    return replace(changed, key=_key(changed))


def _controllers(table: Table, plant: PlantSettings, step: float) -> dict[str, Table]:
    if not table.values:
        raise InputError("no controller", where=table.where(), remedy="add one: [controllers.NAME]")
    found = {name: table.sub(name) for name in table.values}
    for inner in found.values():
        make, process = controller_of(inner, plant)
        if make is None or process is not None:
            raise InputError(
                "another process has no place in a study",
                where=inner.where("kind"),
                remedy="use `hil run`, or give the law as Python or as an FMU",
            )
        made = make()  # what cannot be designed is said now, not by a worker
        getattr(made, "close", lambda: None)()
        ratio = made.period / step
        if ratio < 1 - 1e-6 or abs(ratio - round(ratio)) > 1e-6 * ratio:
            raise InputError(
                f"a controller every {made.period:g} s in cycles of {step:g} s",
                where=inner.where("period"),
                remedy="choose a run.step that its period is a multiple of",
            )
    return found


def _groups(table: Table, units: Mapping[str, str], kind: str) -> dict[str, Mapping[str, Waveform]]:
    found: dict[str, Mapping[str, Waveform]] = {}
    for name in table.values:
        group = table.sub(name)
        waves: dict[str, Waveform] = {}
        for variable in group.values:
            inner = group.sub(variable)
            if variable not in units:
                raise UnknownNameError(kind, variable, units, where=inner.where())
            waves[variable] = waveform_of(inner, units[variable])
        found[name] = waves
    return found or {NONE: {}}


def _variants(table: Table, plant: PlantSettings, roots: tuple[Path, ...]) -> tuple[Variant, ...]:
    listed = table.values.get("effects", [])
    where = table.where("effects")
    if not isinstance(listed, list) or not all(isinstance(e, str) for e in listed):
        raise InputError(
            "effects is no list of texts",
            where=where,
            remedy='write ["CoulombFriction@wheel,tau_c=25"]',
        )
    found = [Variant(NONE, plant.fmu)]
    if listed and plant.model.endswith(".fmu"):
        raise UnsupportedModelError(
            "effects cannot be added to an FMU without its source",
            where=where,
            remedy="give the plant as Modelica",
        )
    for text in listed:
        try:
            source = find_source(plant.model, roots)
            extended = extend(source, [parse_addition(str(text), source)])
            found.append(Variant(str(text), cached_fmu(extended.dae)))
        except TwinproofError as error:
            error.where = f"{where}, {error.where}".rstrip(", ")
            raise
    return tuple(found)


def _ranges(table: Table, plant: PlantSettings) -> dict[str, tuple[float, float]]:
    units = {v.name: v.unit for v in plant.described.parameters}
    found: dict[str, tuple[float, float]] = {}
    for name, value in table.values.items():
        if name not in units:
            raise UnknownNameError("parameter", name, units, where=table.where(name))
        if not isinstance(value, list) or len(value) != 2:
            raise InputError(
                f"{value!r} is no range", where=table.where(name), remedy="write [low, high]"
            )
        low, high = (number(v, units[name], table.where(name)) for v in value)
        if not low <= high:
            raise InputError(
                f"the range from {low:g} to {high:g}", where=table.where(name), remedy="swap them"
            )
        found[name] = (low, high)
    return found


def _offline(criterion: Criterion, table: Table) -> Criterion:
    if isinstance(criterion, MissedFrames | Deadlines | SafeState):
        raise InputError(
            f"'{criterion.kind}' cannot be evaluated without a bus",
            where=table.where("kind"),
            remedy="use it in `hil run`",
        )
    return criterion


def _key(study: Study) -> str:
    digest = hashlib.sha256(study.table.text.encode())
    for variant in study.variants:
        digest.update(variant.fmu.read_bytes())
    fit = study.plant.fit
    if fit is not None:
        digest.update(repr(sorted(fit.values.items())).encode() + fit.covariance.tobytes())
    for table in study.controllers.values():
        fmu = controller_fmu(table)
        if fmu is not None:
            digest.update(Path(fmu).read_bytes())
    return digest.hexdigest()[:32]


def controller_fmu(table: Table) -> str | None:
    """Return the FMU file of a controller that is one; of Modelica, one in the cache."""
    if table.values.get("kind") != "fmu":
        return None
    return str(model_fmu(from_here(str(table.values["model"]), table)))
