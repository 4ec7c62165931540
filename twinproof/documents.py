"""Results as JSON documents; the keys are fixed by the command line's interface."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from fmus.places import Place
from identification.comparison import Comparison
from identification.discovery.diagnosis import Diagnosis
from identification.discovery.drift import Drift
from identification.discovery.effects import Effect
from identification.discovery.empirical import Proposal
from identification.discovery.extension import Addition
from identification.estimate import Estimate
from twinproof.answers import Compared, Diagnosed, FittedRecord, Identified, Improved

Document = dict[str, Any]


def document(command: str, body: Mapping[str, Any]) -> Document:
    """Return a document with its schema first."""
    return {"schema": f"twinproof/{command}/1", **body}


def dumps(value: Document) -> str:
    """Return a document as JSON text; numbers that are not finite become null."""
    return json.dumps(_finite(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value


def horizon_word(horizon: float | None) -> str | float:
    """Return how documents and reports name a horizon: `free`, or its length [s]."""
    return "free" if horizon is None else horizon


def channels(comparison: Comparison) -> Document:
    """Return the channels' errors."""
    return {
        name: {"rmse": c.rmse, "nrmse": c.nrmse, "bias": c.bias, "white_p": c.white_p}
        for name, c in comparison.channels.items()
    }


def compared(result: Compared) -> Document:
    """Return the document of `compare`."""
    comparison = result.comparison
    return document(
        "compare",
        {
            "channels": channels(comparison),
            "nrmse": comparison.nrmse,
            "worst": [
                {
                    "from": failure.begin,
                    "to": failure.end,
                    "channel": failure.channel,
                    "rmse": failure.rmse,
                    "where": {name: list(span) for name, span in failure.where.items()},
                }
                for failure in comparison.worst
            ],
            "horizon": horizon_word(result.horizon),
            "notes": list(result.problem.notes),
        },
    )


def estimate(value: Estimate) -> Document:
    """Return the fitted parameters of an estimate."""
    return {
        name: {"value": p.value, "sd": p.sd, "unit": p.unit, "identifiable": p.identifiable}
        for name, p in value.parameters.items()
    }


def fitted_record(record: FittedRecord) -> Document:
    """Return how a fitted model does on one of the records."""
    return {
        "data": record.origin,
        "samples": len(record.problem.time),
        "channels": channels(record.comparison),
        "nrmse": record.comparison.nrmse,
        "horizon": horizon_word(record.horizon),
    }


def identified(result: Identified) -> Document:
    """Return the document of `identify`."""
    return document(
        "identify",
        {
            "parameters": estimate(result.estimate),
            "method": result.estimate.method,
            "covariance": {
                "names": list(result.estimate.parameters),
                "matrix": result.estimate.covariance.tolist(),
            },
            "condition_number": result.estimate.condition_number,
            "channels": channels(result.comparison),
            "horizon": horizon_word(result.horizon),
            "records": [fitted_record(record) for record in result.records],
            "warnings": list(
                dict.fromkeys(
                    [
                        *result.estimate.warnings,
                        *(note for record in result.records for note in record.problem.notes),
                    ]
                )
            ),
        },
    )


def diagnosis(value: Diagnosis) -> Document:
    """Return a diagnosis without its schema."""
    return {
        "verdict": value.outcome.value,
        "ranking": [
            {
                "effect": row.effect,
                "place": row.place,
                "evidence": row.evidence,
                "explains": row.explains,
                "parameters": {
                    name: {"value": v, "sd": sd, "unit": unit}
                    for name, (v, sd, unit) in row.parameters.items()
                },
                "refitted": row.refitted,
            }
            for row in value.ranking
        ],
        "ties": [list(tie) for tie in value.ties],
        "next_experiment": value.next_experiment,
        "disturbance": value.disturbance,
        "proposal": _proposal(value.proposal),
        "checks": {
            label: {"accepted": v.accepted, "p": v.chance, "removed": v.removed, "reason": v.reason}
            for label, v in value.checks.items()
        },
        "skipped": dict(value.skipped),
    }


def _proposal(value: Proposal | None) -> dict[str, Any] | None:
    if value is None:
        return None
    addition = value.refit.addition
    return {
        "effect": addition.effect.name,
        "place": addition.place.name,
        "parameters": dict(addition.values),
        "over": value.over,
        "evidence": value.refit.evidence,
        "removed": value.verdict.removed,
        "nearest": list(value.nearest),
        "add": value.addition,
    }


def _drifted(value: Drift | None) -> Document | None:
    if value is None:
        return None
    return {
        "verdict": value.change.value,
        "moved": [
            {
                "parameters": {
                    name: {"verified": before, "value": now, "sd": sd}
                    for name, (before, now, sd) in one.values.items()
                },
                "evidence": one.evidence,
                "merit": one.merit,
                "deviations": one.deviations,
            }
            for one in value.moved
        ],
        "effect": value.effect,
        "effect_merit": value.effect_merit,
    }


def diagnosed(result: Diagnosed) -> Document:
    """Return the document of `diagnose`."""
    return document(
        "diagnose",
        {
            **diagnosis(result.diagnosis),
            "drifted": _drifted(result.drift),
            "channels": channels(result.comparison),
            "horizon": horizon_word(result.horizon),
            "records": [fitted_record(record) for record in result.records],
            "notes": _notes(result.records),
        },
    )


def _notes(records: Sequence[FittedRecord]) -> list[str]:
    return list(dict.fromkeys(note for record in records for note in record.problem.notes))


def addition(value: Addition) -> Document:
    """Return an added effect."""
    return {
        "effect": value.effect.name,
        "place": value.place.name,
        "parameters": dict(value.values),
    }


def improved(result: Improved, files: Mapping[int, tuple[str, str]]) -> Document:
    """Return the document of `improve`.

    Args:
        result: The finished ladder.
        files: Step → (model file, FMU file), as written.
    """
    found = result.improvement

    def side(comparison: Comparison | None) -> Document | None:
        if comparison is None:
            return None
        return {
            "channels": {
                name: {"rmse": c.rmse, "nrmse": c.nrmse} for name, c in comparison.channels.items()
            },
            "nrmse": comparison.nrmse,
        }

    return document(
        "improve",
        {
            "verdict": found.outcome.value,
            "added": [addition(a) for a in found.added],
            "ladder": [
                {
                    "step": step.number,
                    "model": files[step.number][0],
                    "fmu": files[step.number][1],
                    "added": None if step.added is None else step.added.label,
                    "accepted": step.verdict is None or step.verdict.accepted,
                    "because": "" if step.verdict is None else step.verdict.reason,
                    "contradicted": step.contradicted,
                    "removed": [a.label for a in step.removed],
                    "parameters": {
                        step.model.user_name(name): {
                            "value": step.fit.values[name],
                            "sd": math.sqrt(step.fit.covariance[k, k]),
                            "identifiable": name not in step.fit.held,
                        }
                        for k, name in enumerate(step.fit.free)
                    },
                    "train": side(step.train),
                    "also": [side(comparison) for comparison in step.also],
                    "holdout": side(step.holdout),
                }
                for step in found.steps
            ],
            "also": list(result.also),
            "noise_floor": dict(found.noise_floor),
            "sensor_noise": dict(found.sensor_noise),
            "ties": [list(t) for step in found.steps for t in step.diagnosis.ties],
            "next_experiment": found.steps[-1].diagnosis.next_experiment,
            "disturbance": found.steps[-1].diagnosis.disturbance,
            "proposal": _proposal(found.steps[-1].diagnosis.proposal),
            "horizon": horizon_word(found.horizon),
            "notes": list(result.problem.notes),
        },
    )


def places(found: tuple[Place, ...]) -> Document:
    """Return the document of `places`."""
    return document(
        "places",
        {
            "places": [
                {"name": p.name, "kind": p.kind, "unit": p.unit, "description": p.description}
                for p in found
            ]
        },
    )


def effects(found: tuple[Effect, ...]) -> Document:
    """Return the document of `effects`."""
    return document(
        "effects",
        {
            "effects": [
                {
                    "name": e.name,
                    "class": e.class_name,
                    "kind": e.kind,
                    "description": e.description,
                    "parameters": {
                        p.name: {
                            "unit": p.unit,
                            "default": d,
                            "description": p.description,
                            "main": p.name in e.main_parameters,
                        }
                        for p, d in zip(e.parameters, e.defaults, strict=True)
                    },
                }
                for e in found
            ]
        },
    )
