"""What the models of the suite must show, computed without the code under test.

`REFERENCES[name](t)` returns the expected columns at the times t; closed forms where there are any,
else SciPy's DOP853 at 1e-12.
"""

import numpy as np
from numpy import cos, exp, floor, log, sin, sqrt
from scipy.integrate import cumulative_simpson, solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq, fsolve

REFERENCES = {}
STOP = {"RestingBall": 30.0}
"""End time [s] where it is not 1.2."""


def reference(function):
    REFERENCES["".join(part.title() for part in function.__name__.split("_"))] = function
    return function


def ode(rhs, start, t, names):
    run = solve_ivp(rhs, (0, t[-1]), start, method="DOP853", t_eval=t, rtol=1e-12, atol=1e-13)
    assert run.success
    return dict(zip(names, run.y, strict=True))


def linear(matrix, start, t, names):
    states = np.array([expm(np.asarray(matrix, float) * s) @ start for s in t])
    return dict(zip(names, states.T, strict=True))


def indexed(name, columns):
    return {f"{name}[{k + 1}]": column for k, column in enumerate(columns)}


def decay(t, start, rate, rest=0.0):
    return rest + (start - rest) * exp(-rate * t)


@reference
def constants(t):
    return {"x": decay(t, 1, 3, 1 / 3)}


@reference
def dependent_parameters(t):
    return {"b": 5 + 0 * t, "c": 10 + 0 * t, "x": decay(t, 10, 1 / 5)}


@reference
def connections(t):
    # Thevenin: 5 V behind 2 Ohm with 6 Ohm across: 3.75 V behind 1.5 Ohm.
    v = decay(t, 0, 1 / 0.15, 3.75)
    return {"capacitor.v": v, "source.i": -(5 - v) / 2, "leak.i": v / 6}


@reference
def extending(t):
    return {"x": decay(t, 3, 4), "r": -4 * decay(t, 3, 4)}


@reference
def redeclared_component(t):
    return {"x": 1 / sqrt(1 + 8 * t)}


@reference
def redeclared_class(t):
    return {"x": decay(t, 1, 5)}


@reference
def inner_outer(t):
    return {"body.v": -3 * t}


@reference
def conditional_component(t):
    return {"v": decay(t, 1, 2)}


@reference
def if_expression(t):
    return {"x": np.where(t < 0.5, 1 - t, 0.5 * exp(-2 * (t - 0.5)))}


@reference
def if_equation(t):
    a, b = np.minimum(t, 0.43), np.clip(t - 0.43, 0, 0.34)
    return {"x": 3 * a - 6 * b + 5 * np.maximum(t - 0.77, 0)}


@reference
def no_event(t):
    return {"x": (1 - t / 2) ** 2}


@reference
def smooth(t):
    return {"x": np.where(t < 1, t - 1, np.tan(t - 1))}


@reference
def min_max(t):
    rise = np.where(t < 0.5, t**2, t - 0.25)
    return {"x": rise + np.maximum(t - 0.7, 0) ** 2 / 2}


@reference
def abs_sign(t):
    x = np.where(t < 0.5, 0.125 - (0.5 - t) ** 2 / 2, 0.125 + (t - 0.5) ** 2 / 2)
    return {"x": x, "y": np.abs(t - 0.47) - 0.47}


@reference
def trigonometry(t):
    columns = (sin(t), cos(t), np.tan(t / 2), np.arcsin(t / 2), np.arccos(t / 2), np.arctan(t))
    return indexed("y", (*columns, np.arctan2(t, 0.3 - t)))


@reference
def exponentials(t):
    columns = (np.sinh(t), np.cosh(t), np.tanh(t), exp(-t), log(1 + t), np.log10(1 + t), sqrt(t))
    return indexed("y", (*columns, (1 + t) ** 2.5))


@reference
def homotopy(t):
    return {"x": 1 / (1 + t)}


@reference
def for_equation(t):
    return indexed("x", [decay(t, 1, k) for k in (1, 2, 3, 4)])


@reference
def nested_for(t):
    return {f"a[{i},{j}]": i * t + j for i in (1, 2) for j in (1, 2, 3)}


@reference
def heat_rod(t):
    n = 12
    matrix = np.diag(-2.0 * np.ones(n)) + np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)
    matrix[0, 0] = matrix[-1, -1] = -1
    return linear(matrix, np.eye(n)[0], t, [f"T[{k + 1}]" for k in range(n)])


@reference
def matrix_product(t):
    A = np.array([[-1.0, 2.0], [0.0, -3.0]])
    x = np.array([expm(A * s) @ [1, 2] for s in t])
    y = x @ A
    return indexed("x", x.T) | indexed("y", y.T) | {"q": np.einsum("ki,ij,kj->k", x, A, x)}


@reference
def array_functions(t):
    x = np.array([1 + t, 2 + 0 * t, 3 - t])
    return {
        "s": 6 + 3 + 2 + 2 * t,
        "p": x.prod(axis=0),
        "m": x.max(axis=0),
        "n": x.min(axis=0),
        **indexed("c", np.cross(x.T, [1, 0, 2]).T),
        **indexed("d", x * np.array([[2], [3], [4]])),
        **indexed("e", [0 * t, t / 2, t]),
    }


@reference
def element_wise(t):
    x = np.array([t, 2 * t, 3 * t])
    return indexed("y", x * x / (1 + x) ** 2) | indexed("z", sin(x) - x / 2)


@reference
def slices(t):
    a, b = 1 * cos(t) - 3 * sin(t), 2 * cos(t) - 4 * sin(t)
    c, d = 3 * cos(t) + 1 * sin(t), 4 * cos(t) + 2 * sin(t)
    return indexed("x", [a, b, c, d]) | {"y[1]": b, "y[2]": d, "z": d}


@reference
def comprehension(t):
    y = [k**2 * t + k for k in (1, 2, 3)]
    return indexed("y", y) | {"s": y[0] + 2 * y[1] + 3 * y[2]}


@reference
def component_array(t):
    stiffness = 4 * np.array([[1, -1, 0], [-1, 2, -1], [0, -1, 1]])
    matrix = np.block([[np.zeros((3, 3)), np.eye(3)], [-stiffness, np.zeros((3, 3))]])
    names = [f"mass[{k}].{v}" for v in "sv" for k in (1, 2, 3)]
    return linear(matrix, np.eye(6)[0], t, names)


@reference
def functions(t):
    return {"x": np.tan(np.pi / 4 - t)}


@reference
def function_of_arrays(t):
    return {"y": 321 * exp(-t)}


@reference
def function_with_if(t):
    return {"y": np.minimum(t, 0.5), "e": np.maximum(t - 0.5, 0)}


@reference
def nested_functions(t):
    return {"x": decay(t, 1, 5)}


@reference
def records(t):
    return {"x": decay(t, 1, 3), "p.a": decay(t, 1, 3), "p.b": 2 * decay(t, 1, 3)}


@reference
def algorithm_section(t):
    return {"x": decay(t, 1, 2, -0.5), "y": 2 * decay(t, 1, 2, -0.5) + 1}


def bounces(t, restitution, last=10**9):
    """Height of a ball dropped from 1 m; it stays down at its `last` bounce."""
    g, height = 9.81, np.zeros_like(t)
    begin, speed, count = sqrt(2 / g), restitution * sqrt(2 * g), 1
    fall = t < begin
    height[fall] = 1 - g * t[fall] ** 2 / 2
    while begin <= t[-1] and count < last:
        flight = 2 * speed / g
        s = t - begin
        here = (s >= 0) & (s < flight)
        height[here] = speed * s[here] - g * s[here] ** 2 / 2
        begin, speed, count = begin + flight, restitution * speed, count + 1
    return height, count


@reference
def reinit(t):
    return {"h": bounces(t, 0.8)[0]}


@reference
def resting_ball(t):
    height, count = bounces(t, 0.97, last=100)
    assert count == 100
    return {"h": height, "n": np.where(t > 29, 100.0, np.nan)}


@reference
def else_when(t):
    step = (t > 0.31).astype(int) + (t > 0.63)
    return {"n": np.array([0, 1, 6])[step], "b": np.array([0, 1, 0])[step]}


@reference
def when_initial(t):
    return {"d": np.where(t < log(2), 1.0, 0.5)}


@reference
def when_algorithm(t):
    return {"n": 1.0 * (t > 0.33), "m": 2.0 * (t > 0.33)}


@reference
def sampling(t):
    x, u, last, columns = 1.0, 0.0, 0.0, np.empty_like(t)
    ticks = 0.1 + 0.25 * np.arange(6)
    for k, now in enumerate(t):
        for tick in ticks[(ticks > last + 1e-9) & (ticks <= now + 1e-9)]:
            x -= u * (tick - last)
            u, last = x, tick
        columns[k] = x - u * (now - last)
    return {"x": columns}


@reference
def sampled_controller(t):
    y, integral, columns, us = 0.0, 0.0, np.empty_like(t), np.empty_like(t)
    for k in range(round(t[-1] / 0.1) + 1):
        integral += 0.1 * (1 - y)
        u = 3 * (1 - y) + 4 * integral
        here = t > 0.1 * k - 1e-9
        columns[here] = decay(t[here] - 0.1 * k, y, 2, u / 2)
        us[here] = u
        y = decay(0.1, y, 2, u / 2)
    return {"y": columns, "u": us}


@reference
def edge_change(t):
    half_turns = floor((10 * t + 0.2) / np.pi)
    return {"rises": floor(half_turns / 2), "changes": half_turns}


@reference
def hysteresis(t):
    s = np.mod(t - 0.2, 0.375)
    cycle = np.where(s < 0.25, 1 - 2 * s, 0.5 + 4 * (s - 0.25))
    return {"T": np.where(t < 0.2, 0.2 + 4 * t, cycle)}


@reference
def boolean_logic(t):
    c = ((t > 0.31) & (t <= 0.73)) | (t > 0.97)
    return {"c": 1.0 * c, "x": np.clip(t - 0.31, 0, 0.42) + np.maximum(t - 0.97, 0)}


@reference
def integer_variables(t):
    return {"i": np.where(t > 0.51, 3, 1), "x": 3 * t + 4 * np.maximum(t - 0.51, 0)}


@reference
def enumeration_parameter(t):
    return {"x": t}


@reference
def enumeration_variable(t):
    return {"mode": np.where(t > 0.57, 2, 1), "x": 0.57 - np.abs(t - 0.57)}


@reference
def time_events(t):
    return {"x": np.clip(t - 0.37, 0, 0.37)}


@reference
def modulo(t):
    whole = floor(t / 0.23)
    rest = t - 0.23 * whole
    return {"x": whole * 0.23**2 / 2 + rest**2 / 2, "y": np.mod(-t - 0.01, 0.3)}


@reference
def div_rem(t):
    s = t + 0.01
    whole = np.trunc(s / 0.3)
    return indexed("y", [whole, np.fmod(s, 0.3), -whole, np.fmod(-s, 0.3)])


@reference
def rounding(t):
    return {"a": floor(5 * t + 0.03), "b": np.ceil(5 * t + 0.03), "i": floor(7 * t + 0.03)}


@reference
def string_labels(t):
    return {"x": decay(t, 1, 2)}


@reference
def initial_flag(t):
    return {"x": decay(t, 5, 2), "rate": 2 + 0 * t, "high": 1 + 0 * t}


@reference
def initial_equation(t):
    # der(y) = 1 gives y = 1 at the start, and der(x) = 0 then x = y = 1.
    return ode(lambda s, z: [-z[0] + z[1] * cos(s), -2 * z[1] + 3], [1, 1], t, "xy")


@reference
def fixed_algebraic(t):
    x = decay(t, 1, 1)  # x³ + x + 6 = 8
    return {"x": x, "y": x**3 + x + 6}


@reference
def free_parameter(t):
    return {"k": 2 + 0 * t, "twice": 4 + 0 * t, "x": decay(t, 1, 4)}  # k³ + k = 10


@reference
def initial_discrete(t):
    return {"x": np.where(t < 0.4, 1 - 1.5 * t, 0.4 - 0.5 * (t - 0.4))}


@reference
def delays(t):
    return {"y": np.where(t < 0.21, 0, sin(2 * (t - 0.21)))}


@reference
def nonlinear_equation(t):
    # With x = y³ + y: dy (3y² + 1) = -y dt, so 1.5 y² + log y = const - t.
    begin = brentq(lambda y: y**3 + y - 1, 0, 1)
    constant = 1.5 * begin**2 + log(begin)
    y = np.array([brentq(lambda y, s=s: 1.5 * y**2 + log(y) - constant + s, 1e-3, 1) for s in t])
    return {"y": y, "x": y**3 + y}


@reference
def nonlinear_system(t):
    def algebraic(x):
        a, b = fsolve(
            lambda z: [z[0] ** 2 + z[1] - 2 - x, z[0] - exp(-z[1]) - 0.5], [1, 1], xtol=1e-12
        )
        return a, b, brentq(lambda c: c + sin(c) - a * b, -9, 9, xtol=1e-14)

    x = ode(lambda s, z: [-algebraic(z[0])[2]], [1], t, "x")["x"]
    return {"x": x} | dict(zip("abc", np.array([algebraic(v) for v in x]).T, strict=True))


@reference
def diode_bridge(t):
    def diode(v):
        return 1e-3 * (exp(10 * v) - 1 if v < 0.5 else exp(5) * (1 + 10 * (v - 0.5)) - 1)

    def current(s):
        u = sin(6 * s)
        return diode(brentq(lambda v: v + 2 * diode(v) - u, -3, 3, xtol=1e-15))

    fine = np.linspace(0, t[-1], 20 * 50 * (t.size - 1) // (t.size - 1) * (t.size - 1) + 1)
    charge = cumulative_simpson([current(s) for s in fine], x=fine, initial=0)
    return {"i": [current(s) for s in t], "q": np.interp(t, fine, charge)}


@reference
def linear_loop(t):
    n = 12
    matrix = 3 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    right = np.zeros((n, t.size))
    right[0], right[-1] = sin(t), 1
    return indexed("v", np.linalg.solve(matrix, right))


@reference
def cartesian_pendulum(t):
    start = np.arctan2(0.6, 0.8)
    angle = ode(lambda s, z: [z[1], -9.81 * sin(z[0])], [start, 0], t, ["phi", "w"])
    return {"x": sin(angle["phi"]), "y": -cos(angle["phi"])}


@reference
def rigid_shaft(t):
    inertia = 0.5 + 3 / 4
    run = ode(lambda s, z: [z[1], (sin(4 * s) - 0.2 * z[1] / 4) / inertia], [0, 1], t, ["phi", "w"])
    return {"motor.phi": run["phi"], "load.phi": run["phi"] / 2, "load.w": run["w"] / 2}


@reference
def capacitor_loop(t):
    v = decay(t, 1, 1 / 5)
    return {"v1": v, "i1": -2 / 5 * v, "i2": -3 / 5 * v}


@reference
def stiff(t):
    return {"x": cos(t), "y": (cos(t) + sin(t)) / 2 + 1.5 * exp(-t)}


@reference
def stick_slip(t):
    s = np.minimum(t, 1 / 1.5)
    return {"x": s - 0.75 * s**2, "v": 1 - 1.5 * s}


@reference
def assertion(t):
    return {"x": t}


@reference
def inputs_outputs(t):
    x = decay(t, 0, 1, 0.7)
    return {"x": x, "y": 1.4 + x}


@reference
def blocks(t):
    return {"position.y": sin(2 * t) / 2, "velocity.y": cos(2 * t)}


@reference
def higher_derivatives(t):
    return {"y": exp(-2 * t), "w": -2 * exp(-2 * t)}


@reference
def types_and_units(t):
    return {"phi": cos(3 * t), "w": -3 * sin(3 * t)}


@reference
def import_(t):
    return {"x": decay(t, 1, 2.5)}


REFERENCES["Import"] = REFERENCES.pop("Import" if "Import" in REFERENCES else "Import_")
