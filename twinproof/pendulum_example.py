"""A small case to try things on: a pendulum that has a friction which its model lacks."""

from __future__ import annotations

import numpy as np
import pandas as pd

from recordings import Recording
from twinproof.model import Model

_STEP, _SAMPLES, _SUBSTEPS = 0.01, 400, 20
_J, _MGL, _D, _TAU_C, _NOISE = 0.185, 3.61, 0.02, 0.15, 1e-3


def example() -> tuple[Model, Recording, Recording]:
    """Return a model, a recording to fit and an unseen one, of a motor-driven pendulum.

    Both recordings have the channels `tau` [N.m] and `theta` [rad], 4 s at 100 Hz, with a noise of
    1 mrad. The pendulum that they are of has dry friction of 0.15 N.m at its joint, by Euler's
    rule in steps of 0.5 ms; the model, `Twinproof.Plants.Pendulum`, has none.

    Example:
        >>> model, record, unseen = example()
        >>> model.word, list(record.channels), record.duration
        ('Twinproof.Plants.Pendulum', ['tau', 'theta'], 3.99)
    """
    return Model.of("Twinproof.Plants.Pendulum"), _swing(1), _swing(2)


def _swing(seed: int) -> Recording:
    random = np.random.default_rng(seed)
    time = np.arange(_SAMPLES) * _STEP
    phases = random.uniform(0.0, 2 * np.pi, 3)
    tau = sum(np.sin(w * time + p) for w, p in zip((1.9, 3.1, 6.7), phases, strict=True))
    angle, speed = 0.2, 0.0
    theta = np.empty(_SAMPLES)
    for k, torque in enumerate(np.asarray(tau).tolist()):
        theta[k] = angle
        for _ in range(_SUBSTEPS):
            friction = _D * speed + _TAU_C * np.tanh(speed / 0.01)
            speed += _STEP / _SUBSTEPS * (torque - _MGL * np.sin(angle) - friction) / _J
            angle += _STEP / _SUBSTEPS * speed
    theta += _NOISE * random.standard_normal(_SAMPLES)
    frame = pd.DataFrame({"tau": tau, "theta": theta}, index=pd.Index(time, name="time"))
    return Recording.from_frame(frame, units={"tau": "N.m", "theta": "rad"})
