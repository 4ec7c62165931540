"""The benchmark's table, every share with its exact (Clopper–Pearson) 95 % interval."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.stats import beta

from benchmarks.hidden_effects.cases import cases
from benchmarks.hidden_effects.detectability import DETECTABLE

Row = dict[str, Any]
_NOTHING = ("noise", "disturbance", "poor excitation", "known bias")


def interval(successes: float, trials: int) -> tuple[float, float]:
    """Return the 95 % Clopper–Pearson interval of a share.

    Example:
        >>> [round(x, 3) for x in interval(0, 300)]
        [0.0, 0.012]
    """
    if trials == 0:
        return 0.0, 1.0
    low = beta.ppf(0.025, successes, trials - successes + 1) if successes > 0 else 0.0
    high = beta.ppf(0.975, successes + 1, trials - successes) if successes < trials else 1.0
    return float(low), float(high)


def _share(name: str, rows: Sequence[Row], good: Callable[[Row], float], asked: str) -> str:
    total = sum(good(row) for row in rows)
    low, high = interval(total, len(rows))
    value = 100 * total / len(rows) if rows else float("nan")
    band = f"{100 * low:.1f} to {100 * high:.1f} %"
    return f"| {name} | {value:.1f} % | {band} | {len(rows)} | {asked} |"


def table(rows: Sequence[Row]) -> str:
    """Return the table as Markdown."""
    worked = [r for r in rows if not r["trouble"]]
    nameless = {case.name for case in cases() if case.nameless}
    named = [r for r in worked if r["name"] not in nameless]
    ones = [r for r in named if r["group"] == "one"]
    seen = [r for r in ones if r["nats"] > DETECTABLE]
    nothing = [r for r in worked if r["group"] in _NOTHING]
    twos = [r for r in named if r["group"] == "two" and r["nats"] > DETECTABLE]
    unknown = [r for r in worked if r["group"] == "unknown" and r["nats"] > DETECTABLE]
    lines = [
        "| figure | measured | 95 % interval | cases | asked |",
        "|---|---|---|---|---|",
        _share("named first (a tie of k ≤ 3 counts 1/k)", seen, lambda r: r["point"], "≥ 95 %"),
        _share("named first, alone", seen, lambda r: r["point"] == 1.0, ""),
        _share("false additions, nothing missing", nothing, lambda r: bool(r["first"]), "≤ 1 %"),
        *(
            _share(f"… {kind}", kept, lambda r: bool(r["first"]), "")
            for kind in _NOTHING
            if (kept := [r for r in nothing if r["group"] == kind])
        ),
        _share("two effects, both found", twos, lambda r: r["found"] == 2, "≥ 85 %"),
        _share(
            "held-out error ≤ 1.1 noise floors", seen, lambda r: r["over_floor"] <= 1.1, "≥ 90 %"
        ),
        _share(
            "law of no library called complete", unknown, lambda r: r["verdict"] == "complete", "0"
        ),
    ]
    for plant in sorted({r["plant"] for r in seen}):
        kept = [r for r in seen if r["plant"] == plant]
        lines.append(_share(f"named first, {plant}", kept, lambda r: r["point"], ""))
    excluded = len(ones) - len(seen)
    troubles = [r for r in rows if r["trouble"]]
    seconds = [r["seconds"] for r in worked]
    lines += [
        "",
        f"{len(rows)} cases worked; {excluded} of {len(ones)} single effects "
        f"({100 * excluded / max(len(ones), 1):.0f} %) are left out because their record shows "
        f"less than {DETECTABLE:g} nats of them, {len(worked) - len(named)} cases because the "
        "model has a parameter for what they hide, which leaves only its bend; "
        f"{len(troubles)} cases gave no answer. "
        f"Seconds a case: median {np.median(seconds) if seconds else float('nan'):.1f}, "
        f"largest {max(seconds, default=float('nan')):.1f}.",
    ]
    lines += [f"- no answer: {r['name']}: {r['trouble']}" for r in troubles]
    return "\n".join(lines)
