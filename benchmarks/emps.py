"""The main job on the electro-mechanical positioner: from mass and viscous friction only."""

from __future__ import annotations

import time
from collections.abc import Iterator

import twinproof
from benchmarks.figures import Figure
from fmus.frontend import load
from fmus.sources import ModelicaSource
from identification.estimators import Differencing
from identification.problem import match

PUBLISHED = {"M": 95.1089, "Fv": 203.5034, "friction.f_c": 20.3935, "offset.f_0": 3.1648}
_WITH_FRICTION = """model Friction
  extends Twinproof.Plants.Positioner;
  Twinproof.Effects.Translational.CoulombFriction friction;
  Twinproof.Effects.Translational.ConstantForce offset;
equation
  connect(friction.flange, carriage.flange);
  connect(offset.flange, carriage.flange);
end Friction;
"""


def published() -> Iterator[Figure]:
    """The authors' parameters from the authors' record, by their kind of method."""
    record = twinproof.read_recording("emps", twinproof.Model.of("Twinproof.Plants.Positioner"))
    dae = load(ModelicaSource(_WITH_FRICTION, "Friction", "Friction.mo", "Friction"))
    values = Differencing(band=100.0).estimate(match(dae, record)).values
    for name, value in PUBLISHED.items():
        off = 100 * abs(values[name] / value - 1)
        yield Figure(f"EMPS {name.split('.')[-1]}, from the published value", off, 1.0, "%")


def run() -> Iterator[Figure]:
    yield from published()
    model = twinproof.Model.of("Twinproof.Plants.Positioner")
    train = twinproof.read_recording("emps", model)
    unseen = twinproof.read_recording("emps-pulses", model)
    began = time.perf_counter()
    found = twinproof.improve(model, train, unseen).improvement
    seconds = time.perf_counter() - began
    for step in found.steps:
        assert step.holdout is not None
        label = "as given" if step.added is None else "+ " + step.added.label
        yield Figure(f"EMPS {label}, fitted", 1e3 * step.train.channels["q"].rmse, None, "mm")
        yield Figure(f"EMPS {label}, unseen", 1e3 * step.holdout.channels["q"].rmse, None, "mm")
    last = found.steps[-1]
    assert last.holdout is not None
    first = found.added[0].effect.name if found.added else ""
    yield Figure("EMPS Coulomb-type friction first", float("Coulomb" in first), 1, "", True)
    yield Figure("EMPS fitted, free 24.8 s", 1e3 * last.train.channels["q"].rmse, 3.0, "mm")
    yield Figure("EMPS unseen, free 24.8 s", 1e3 * last.holdout.channels["q"].rmse, 4.5, "mm")
    yield Figure(
        "EMPS steps contradicted by the unseen record",
        sum(step.contradicted for step in found.steps),
        0,
    )
    yield Figure("EMPS improve, whole", seconds, 60.0, "s")
