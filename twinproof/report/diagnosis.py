"""The report of `diagnose`: which physical effect is missing, and what speaks for it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from identification.comparison import Comparison
from identification.discovery.diagnosis import Diagnosis, Outcome
from identification.problem import Problem
from twinproof.report import wording
from twinproof.report.comparison import error_sentence, record_context
from twinproof.report.page import provenance, write_page
from twinproof.report.tables import candidate_rows

MEANS = {
    Outcome.COMPLETE: "What the fitted model leaves over is the sensors’ noise.",
    Outcome.EFFECT: "It passed cross-validation on windows that its fit had not seen. "
    "“twinproof improve” adds it.",
    Outcome.UNDETERMINED: "Several effects explain these data alike; see what to record next.",
    Outcome.UNKNOWN_SHAPE: "The error is above the sensors’ noise, but no effect at any place "
    "explains it beyond chance by itself; “twinproof improve” also tries two together. Look at the "
    "error against the observed variables for its shape.",
    Outcome.SENSOR: "The error is in what was measured, not in the motion.",
}


def write_diagnosis(
    diagnosis: Diagnosis,
    comparison: Comparison,
    problem: Problem,
    path: Path,
    *,
    command: str,
    notes: Sequence[str] = (),
) -> None:
    """Write the report of a diagnosis as one self-contained HTML file.

    Args:
        diagnosis: The verdict with its ranking.
        comparison: The fitted model against the record.
        problem: Model and record.
        path: File to write.
        command: That repeats the run.
        notes: What a reader should know of the data.

    Raises:
        OSError: The file cannot be written.
    """
    rule = wording.horizon_rule(comparison.prediction.horizon, float(problem.time[-1]))
    refitted, scored = candidate_rows(diagnosis)
    chosen = "" if diagnosis.chosen is None else diagnosis.chosen.addition.label
    write_page(
        path,
        "diagnosis.html",
        headline=wording.diagnosis_headline(diagnosis, problem.dae.name),
        verdict=diagnosis.outcome.value,
        means=MEANS[diagnosis.outcome],
        summary=error_sentence(problem, comparison),
        refitted=refitted,
        scored=scored,
        skipped=dict(diagnosis.skipped),
        ties=[wording.tied(tie, chosen) for tie in diagnosis.ties],
        next_experiment=diagnosis.next_experiment,
        provenance=provenance(command, rule, {"Record": problem}, notes),
        **record_context(problem, comparison),
    )
