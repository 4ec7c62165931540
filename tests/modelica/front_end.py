"""What the tests of the Modelica library share: its classes, and the front end to run them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rumoca

from modelica import LIBRARY

TIGHT = rumoca.SimConfig(rtol=1e-10, atol=1e-12)
# The default solver stops on about one short run in a thousand ("accepted-interval left endpoint
# sampler ... disagreement"); this one never did in 6000, but it ignores `delay`.
EXPLICIT = rumoca.SimConfig(rtol=1e-10, atol=1e-12, solver="rk-like")


def source_files() -> list[Path]:
    return sorted(LIBRARY.rglob("*.mo"))


def class_name(path: Path) -> str:
    """`Twinproof.Effects.Signal.Gain` for the file that holds it."""
    parts = path.relative_to(LIBRARY.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "package" else parts)


def names_in(folder: str) -> list[str]:
    """Bare names of the classes in one package, such as `Effects/Signal`."""
    return sorted(p.stem for p in (LIBRARY / folder).glob("*.mo") if p.stem != "package")


def load(text: str) -> Any:
    """The model `Q` of `text`, in a session that has seen nothing else."""
    return rumoca.Session(roots=[str(LIBRARY.parent)]).loads(text, model="Q")


def load_class(name: str) -> Any:
    return load(f"model Q extends {name}; end Q;")


def variables(model: Any) -> Iterator[Any]:
    """Every variable and parameter, as the front end describes it."""
    for view in (model.states, model.algebraics, model.inputs, model.outputs, model.parameters):
        for name in view.names:
            yield view[name]


def simulate(
    model: Any,
    stop: float,
    points: int = 201,
    params: Mapping[str, float] | None = None,
    config: rumoca.SimConfig = TIGHT,
) -> dict[str, np.ndarray]:
    """Trajectories from 0 to `stop` [s], with `time` among them."""
    step = stop / (points - 1)
    result = model.simulate((0.0, stop), dt=step, config=config, params=dict(params or {}))
    return {"time": np.asarray(result.time)} | {n: np.asarray(result[n]) for n in result.names}
