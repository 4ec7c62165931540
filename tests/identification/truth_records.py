"""Problems whose records come from right-hand sides written here and integrated by DOP853.

Nothing here comes from the product but the types that it is handed.
"""

from dataclasses import replace

import numpy as np
from scipy.integrate import ode

from fmus.frontend import load
from fmus.sources import ModelicaSource, library_class
from identification.problem import Problem, fitted_by_default

X = {"X1": 0.0436, "X2": 0.0178, "X3": 0.1149, "X4": 0.8719, "X5": 4.6701, "X6": 0.7268}
X |= {"X7": 0.7256}
ALPHA = 165.418
PENDULUM = {"J": 0.185, "mgl": 3.61, "d": 0.006}
POSITIONER = {"M": 95.1089, "Fv": 203.5034}


def library(name):
    return library_class(f"Twinproof.Plants.{name}")


def own(text, name="A"):
    return ModelicaSource(text, name, f"{name}.mo", f"{name}.mo:{name}")


def held(rates, start, inputs, step, *, rtol=1e-11, atol=1e-13):
    """States (n, nx) at the samples; each input (a scalar or vector) is held for one step."""
    states = np.empty((len(inputs), len(start)))
    solver = ode(rates).set_integrator("dop853", rtol=rtol, atol=atol, nsteps=100_000)
    solver.set_initial_value(list(start), 0.0)
    for k, u in enumerate(inputs):
        states[k] = solver.y
        if k + 1 < len(inputs):
            solver.set_f_params(u)
            solver.integrate((k + 1) * step)
            assert solver.successful()
    return states


def pendulum_rates(J=0.185, mgl=3.61, d=0.006, coulomb=0.0, drag=0.0):
    def rates(_, x, torque):
        friction = d * x[1] + coulomb * np.tanh(x[1] / 0.05) + drag * x[1] * abs(x[1])
        return [x[1], (torque - mgl * np.sin(x[0]) - friction) / J]

    return rates


def positioner_rates(M=95.1089, Fv=203.5034, coulomb=0.0):
    def rates(_, x, volts):
        return [x[1], (35.1507 * volts - Fv * x[1] - coulomb * np.tanh(x[1] / 1e-3)) / M]

    return rates


def wheeled_rates(coulomb=0.0):
    """Equations (19) and (20) of the paper, as a 2 by 2 system solved by hand."""
    x1, x2, x3, x4, x5, x6, x7 = X.values()

    def rates(_, x, volts):
        _, p, ww, wp = x
        s, c = np.sin(p), np.cos(p)
        right1 = volts - coulomb * np.tanh(ww / 0.05) / ALPHA + x3 * wp**2 * s - x6 * ww + x7 * wp
        right2 = volts - x5 * s - x6 * ww + x7 * wp
        m11, m12, m21, m22 = x1 + x2, x3 * c - x2, -(x3 * c - x2), -(x4 + x2)
        det = m11 * m22 - m12 * m21
        return [ww, wp, (m22 * right1 - m12 * right2) / det, (m11 * right2 - m21 * right1) / det]

    return rates


def swing(n, step):
    """A torque that moves the pendulum through large angles."""
    t = np.arange(n) * step
    return 1.5 * np.sin(3 * t) + 0.8 * np.sin(8.3 * t + 1) + 0.3 * np.sin(17 * t)


def shuttle(n, step):
    """A voltage that moves the carriage back and forth."""
    t = np.arange(n) * step
    return 3 * np.sin(5 * t) + 1.5 * np.sin(13 * t + 1)


def balanced(duration, step=1e-3, coulomb=0.0):
    """Voltages and states of the wheeled pendulum under a PD controller, noise-free."""
    rates = wheeled_rates(coulomb)
    n = round(duration / step) + 1
    states, volts = np.empty((n, 4)), np.empty(n)
    solver = ode(rates).set_integrator("dop853", rtol=1e-11, atol=1e-13)
    solver.set_initial_value([0.0, 0.05, 0.0, 0.0], 0.0)
    for k in range(n):
        t, x = k * step, solver.y
        states[k] = x
        wanted = np.radians(6 * np.sin(7 * t) + 6 * np.cos(4 * t) - 6 * np.sin(t))
        volts[k] = 168 * (x[1] - wanted) + 14 * x[3]
        if k + 1 < n:
            solver.set_f_params(volts[k])
            solver.integrate((k + 1) * step)
    return volts, states


def problem(source, inputs, outputs, step, *, names, sd=None, free=None, wrong=1.0, values=None):
    """A problem whose starting values are `wrong` times the declared ones."""
    dae = load(source)
    chosen = fitted_by_default(dae) if free is None else tuple(free)
    declared = {
        name: value * (wrong if name in chosen else 1.0)
        for name, value in dae.parameter_values.items()
        if name not in dae.dependent_parameters
    }
    inputs = np.asarray(inputs, float)
    return Problem(
        dae=dae,
        time=np.arange(len(inputs)) * step,
        inputs=inputs.reshape(len(inputs), -1),
        outputs=np.asarray(outputs, float).reshape(len(inputs), -1),
        output_names=tuple(names),
        noise_sd=np.full(len(names), np.nan) if sd is None else np.asarray(sd, float),
        free=chosen,
        values={**declared, **(values or {})},
    )


def noisy(given, sd, seed):
    """The problem with white noise on its outputs, and sensors that say so."""
    noise = np.random.default_rng(seed).standard_normal(given.outputs.shape)
    sd = np.asarray(sd, float)
    return replace(given, outputs=given.outputs + noise * sd, noise_sd=sd)


def pendulum_problem(duration=6.0, step=2e-3, *, outputs=("theta",), coulomb=0.0, **options):
    """A noise-free swing of the library's pendulum."""
    n = round(duration / step) + 1
    torque = swing(n, step)
    states = held(pendulum_rates(coulomb=coulomb), [0.4, -0.5], torque, step)
    columns = [("theta", "omega").index(name) for name in outputs]
    return problem(library("Pendulum"), torque, states[:, columns], step, names=outputs, **options)
