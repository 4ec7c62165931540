"""What the calls of `twinproof` return: a notebook shows it, `plot()` draws it, pandas takes it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from identification.comparison import Comparison
from identification.discovery.diagnosis import Diagnosis
from identification.discovery.drift import Drift
from identification.discovery.ladder import Improvement
from identification.estimate import Estimate
from identification.problem import Problem
from twinproof.model import Model

if TYPE_CHECKING:
    from twinproof.report.notebook import Plot


@dataclass(frozen=True)
class Compared:
    """The outcome of `compare`.

    Attributes:
        problem: Model and record, matched.
        comparison: Errors, and where the model fails.
        horizon: Window length [s]; None for the free simulation.

    Example:
        >>> import twinproof
        >>> model, record, _ = twinproof.example()
        >>> compared = twinproof.compare(model, record)
        >>> print(f"{100 * compared.comparison.nrmse:.0f} %")
        36 %
        >>> compared.to_frame()["theta"].round(3).head(2)
              measured  simulated  error
        time
        0.00     0.199      0.196  0.003
        0.01     0.201      0.196  0.004
        >>> [picture.caption.partition(".")[0] for picture in compared.plot().pictures]
        ['Left the whole record, right the shaded span', 'Measured minus simulated']
    """

    problem: Problem
    comparison: Comparison
    horizon: float | None

    def to_frame(self) -> pd.DataFrame:
        """Return measured, simulated and error of every channel over time [s]."""
        return _curves(self.problem, self.comparison)

    def plot(self) -> Plot:
        """Return measured against simulated, and the error over time."""
        from twinproof.report import notebook  # noqa: PLC0415 - Matplotlib takes its time

        return notebook.comparison_plot(self.problem, self.comparison)

    def _repr_html_(self) -> str:
        from twinproof.report import notebook  # noqa: PLC0415

        return notebook.comparison_html(self.problem, self.comparison)


def _curves(problem: Problem, comparison: Comparison) -> pd.DataFrame:
    prediction = comparison.prediction
    columns: dict[tuple[str, str], np.ndarray[tuple[int], np.dtype[np.float64]]] = {}
    for k, name in enumerate(problem.output_names):
        columns[name, "measured"] = problem.outputs[:, k]
        columns[name, "simulated"] = prediction.simulated[:, k]
        columns[name, "error"] = prediction.error[:, k]
    return pd.DataFrame(columns, index=pd.Index(problem.time, name="time"))


@dataclass(frozen=True)
class FittedRecord:
    """One of the records of `identify` or `diagnose`, and how the fitted model does on it.

    Attributes:
        origin: Where the record comes from.
        problem: Model and record, with the fitted values.
        comparison: Errors, and where the model fails.
        horizon: Window length [s]; None for the free simulation.
    """

    origin: str
    problem: Problem
    comparison: Comparison
    horizon: float | None


class _FirstRecord:
    """Of several fitted records, the first speaks for all where there is room for one."""

    records: tuple[FittedRecord, ...]

    @property
    def problem(self) -> Problem:
        """Of the first record."""
        return self.records[0].problem

    @property
    def comparison(self) -> Comparison:
        """Of the first record."""
        return self.records[0].comparison

    @property
    def horizon(self) -> float | None:
        """Of the first record."""
        return self.records[0].horizon


@dataclass(frozen=True)
class Identified(_FirstRecord):
    """The outcome of `identify`.

    Attributes:
        estimate: The fitted parameters.
        records: Every record fitted, in the order given.

    Example:
        >>> import twinproof
        >>> model, record, _ = twinproof.example()
        >>> fitted = twinproof.identify(model, record)
        >>> fitted.to_frame()[["value", "unit"]].astype({"value": float}).round(2)
                   value       unit
        parameter
        J           0.19      kg.m2
        mgl         3.64        N.m
        d           0.07  N.m.s/rad
        >>> len(fitted.plot().pictures)
        2
    """

    estimate: Estimate
    records: tuple[FittedRecord, ...]

    def to_frame(self) -> pd.DataFrame:
        """Return the parameters: value, standard deviation, unit, and whether the data see it."""
        return pd.DataFrame(
            {
                name: {"value": p.value, "sd": p.sd, "unit": p.unit, "identifiable": p.identifiable}
                for name, p in self.estimate.parameters.items()
            }
        ).T.rename_axis("parameter")

    def plot(self) -> Plot:
        """Return the first record against the fitted model, and the error over time."""
        from twinproof.report import notebook  # noqa: PLC0415

        return notebook.comparison_plot(self.problem, self.comparison)

    def _repr_html_(self) -> str:
        from twinproof.report import notebook  # noqa: PLC0415

        return notebook.comparison_html(self.problem, self.comparison, self.estimate)


@dataclass(frozen=True)
class Diagnosed(_FirstRecord):
    """The outcome of `diagnose`.

    Attributes:
        diagnosis: What is missing.
        records: Every record fitted, in the order given.
        drift: Whether verified parameters moved; None if none were given.

    Example:
        >>> import twinproof
        >>> model, record, _ = twinproof.example()
        >>> found = twinproof.diagnose(model, record)
        >>> found.diagnosis.outcome.value
        'effect'
        >>> best = found.to_frame().iloc[0]
        >>> print(f"{best.effect} at {best.place} explains {100 * best.explains:.0f} %")
        CoulombFriction at joint explains 99 %
        >>> found.plot().pictures[0].caption.partition(":")[0]
        'Each dot'
    """

    diagnosis: Diagnosis
    records: tuple[FittedRecord, ...]
    drift: Drift | None = None

    def to_frame(self) -> pd.DataFrame:
        """Return the ranking: effect, place, evidence [nats], share explained, refitted."""
        return pd.DataFrame(
            [
                {
                    "effect": row.effect,
                    "place": row.place,
                    "evidence": row.evidence,
                    "explains": row.explains,
                    "refitted": row.refitted,
                }
                for row in self.diagnosis.ranking
            ]
        )

    def plot(self) -> Plot:
        """Return the shape of what is missing, and where the fitted model fails."""
        from twinproof.report import notebook  # noqa: PLC0415

        return notebook.diagnosis_plot(self.diagnosis, self.problem, self.comparison)

    def _repr_html_(self) -> str:
        from twinproof.report import notebook  # noqa: PLC0415

        return notebook.diagnosis_html(self.diagnosis, self.problem)


@dataclass(frozen=True)
class Improved:
    """The outcome of `improve`.

    Attributes:
        problem: The first fitted record.
        holdout: The unseen record.
        improvement: The ladder.
        also: Where the further fitted records come from.

    Example:
        >>> import twinproof
        >>> model, record, unseen = twinproof.example()
        >>> improved = twinproof.improve(model, record, unseen, max_effects=1)
        >>> improved.to_frame()["added"].tolist()
        ['', 'CoulombFriction@joint']
        >>> bool(improved.to_frame()["unseen"].iloc[-1] < 0.01)
        True
        >>> better = twinproof.compare(improved.model, unseen)
        >>> len(improved.plot().pictures)
        2
    """

    problem: Problem
    holdout: Problem | None
    improvement: Improvement
    also: tuple[str, ...] = ()

    @property
    def model(self) -> Model:
        """The last step's model, with fitted values as defaults.

        Raises:
            UnsupportedModelError: It is a foreign FMU in a system (`results.write_improvement`).
        """
        return Model.of(self.improvement.steps[-1].model)

    def to_frame(self) -> pd.DataFrame:
        """Return the ladder: what each step added, and its errors as shares of the deviation."""
        return pd.DataFrame(
            [
                {
                    "added": "" if step.added is None else step.added.label,
                    "fitted": step.train.nrmse,
                    "unseen": math.nan if step.holdout is None else step.holdout.nrmse,
                }
                for step in self.improvement.steps
            ]
        ).rename_axis("step")

    def plot(self) -> Plot:
        """Return the ladder, and the shape of every force that was added."""
        from twinproof.report import notebook  # noqa: PLC0415

        return notebook.improvement_plot(self.improvement, self.problem, self.holdout)

    def _repr_html_(self) -> str:
        from twinproof.report import notebook  # noqa: PLC0415

        return notebook.improvement_html(self.improvement, self.problem)
