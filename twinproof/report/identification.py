"""The report of `identify`: fitted parameters, and how well the model then does."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from identification.comparison import Comparison
from identification.estimate import Estimate
from identification.problem import Problem
from twinproof.report import wording
from twinproof.report.comparison import error_sentence, record_context
from twinproof.report.numbers import significant
from twinproof.report.page import provenance, write_page
from twinproof.report.tables import estimate_rows


def write_identification(
    estimate: Estimate,
    comparison: Comparison,
    problem: Problem,
    path: Path,
    *,
    command: str,
    notes: Sequence[str] = (),
) -> None:
    """Write the report of an identification as one self-contained HTML file.

    Args:
        estimate: The fitted parameters.
        comparison: The model with these parameters against the record.
        problem: Model and record.
        path: File to write.
        command: That repeats the run.
        notes: What a reader should know of the data.

    Raises:
        OSError: The file cannot be written.
    """
    rule = wording.horizon_rule(comparison.prediction.horizon, float(problem.time[-1]))
    known = [(n, p.value, p.sd) for n, p in estimate.parameters.items() if p.identifiable]
    held = [n for n, p in estimate.parameters.items() if not p.identifiable]
    warnings = [
        *estimate.warnings,
        *wording.fit_warnings(known, [], estimate.condition_number),
    ]
    count = len(known)
    fitted = f"{count} parameter{'s' if count != 1 else ''}"
    if held:
        fitted += f" ({wording.listed(held)} held: the data do not see it)"
    write_page(
        path,
        "identification.html",
        headline=f"{problem.dae.name}: {fitted} fitted",
        summary=error_sentence(problem, comparison),
        method=estimate.method,
        parameters=estimate_rows(estimate, problem),
        condition_number=significant(estimate.condition_number, 2),
        warnings=list(dict.fromkeys(warnings)),
        provenance=provenance(command, rule, {"Record": problem}, notes),
        **record_context(problem, comparison),
    )
