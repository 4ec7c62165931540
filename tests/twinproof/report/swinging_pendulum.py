"""A pendulum with dry friction at its joint, simulated by SciPy; its model knows nothing of it."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from recordings import Channel, Recording, Sensor

J, MGL, D = 0.185, 3.61, 0.006
COULOMB, WIDTH = 0.30, 0.05
NOISE = {"theta": 1e-3, "omega": 1e-2}
SAMPLE_TIME = 0.005


def swing(seconds: float, seed: int, coulomb: float = COULOMB) -> Recording:
    """Simulate a swinging pendulum with Coulomb friction; the torque is held between samples."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds / SAMPLE_TIME) + 1) * SAMPLE_TIME
    phases = rng.uniform(0, 2 * np.pi, 4)
    tones = zip((1.1, 2.9, 4.3, 7.7), phases, strict=True)
    torque = sum(0.6 * np.sin(w * time + p) for w, p in tones)

    def rates(t: float, x: np.ndarray) -> list[float]:
        tau = torque[min(int(t / SAMPLE_TIME + 1e-9), len(torque) - 1)]
        friction = D * x[1] + coulomb * np.tanh(x[1] / WIDTH)
        return [x[1], (tau - MGL * np.sin(x[0]) - friction) / J]

    solution = solve_ivp(
        rates, (0, time[-1]), [0.8, 0.0], t_eval=time, max_step=SAMPLE_TIME / 2, rtol=1e-7
    )
    measured = {
        name: values + NOISE[name] * rng.standard_normal(len(time))
        for name, values in zip(("theta", "omega"), solution.y, strict=True)
    }
    channels = {
        "tau": Channel("tau", torque, "N.m"),
        "theta": Channel("theta", measured["theta"], "rad", Sensor(sd=NOISE["theta"])),
        "omega": Channel("omega", measured["omega"], "rad/s", Sensor(sd=NOISE["omega"])),
    }
    return Recording(time, channels, origin=f"simulated by SciPy, seed {seed}")
