"""A solved model as C: the header file that the FMU runtime is compiled with."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence

import casadi as ca

from fmus.casadi_expressions import SX
from fmus.dae import Dae
from fmus.events import EventSystem, event_system
from fmus.explicit import ExplicitModel
from fmus.initialisation import InitialSystem, initial_system
from fmus.layout import Layout

GUID_MARK = "@GUID@"
"""Stands in generated text where the GUID goes, which is computed from that text."""


def model_header(model: ExplicitModel, layout: Layout) -> str:
    """Return `model.h`: sizes, tables and functions of one model, all static.

    Args:
        model: Solved with frozen relations.
        layout: Its variables.

    Raises:
        UnsupportedModelError: Events or initial equations have no translation.
    """
    events = event_system(model)
    initial = initial_system(model)
    return "\n".join(
        [
            f"/* Generated from the Modelica model {model.dae.name}. */",
            "#ifndef TWINPROOF_MODEL_H",
            "#define TWINPROOF_MODEL_H",
            "",
            *_sizes(model, layout, events, initial),
            "",
            *_tables(model, layout, events, initial),
            "",
            _c_functions(_functions(model, layout, events, initial)),
            "#endif",
            "",
        ]
    )


def _sizes(
    model: ExplicitModel, layout: Layout, events: EventSystem, initial: InitialSystem
) -> list[str]:
    sizes = {
        "PARAMETERS": len(model.parameter_names),
        "INPUTS": len(model.input_names),
        "STATES": len(model.state_names),
        "DISCRETES": len(model.discrete_names),
        "OTHERS": len(layout.others),
        "RELATIONS": len(model.dae.relations),
        "TRIGGERS": events.triggers.shape[0],
        "DELAYS": len(model.dae.delays),
        "INITIAL": len(initial.states),
        "LOOPS": len(model.loop_names),
        "LOOP_BLOCKS": len(model.loop_sizes),
        "DISCRETE_EQUATIONS": len(model.dae.discrete_equations),
        "ASSERTIONS": len(model.dae.assertions),
    }
    return [
        f'#define MODEL_GUID "{GUID_MARK}"',
        *(f"#define N_{name} {number}" for name, number in sizes.items()),
    ]


def _tables(
    model: ExplicitModel, layout: Layout, events: EventSystem, initial: InitialSystem
) -> list[str]:
    dae = model.dae
    # A nominal value of zero says nothing about the size of a state.
    nominals = (abs(dae.number(v.nominal, 1.0)) or 1.0 for v in dae.states)
    return [
        "/* Start values of parameters, inputs, states and discrete variables. */",
        _table("double", "start_values", map(repr, layout.starts)),
        _table("unsigned char", "is_tunable", (str(int(t)) for t in layout.tunable)),
        _table("double", "nominals", map(repr, nominals)),
        _table("char *const", "state_names", (f'"{name}"' for name in model.state_names)),
        "/* Relations that are false where their indicator is zero. */",
        _table("unsigned char", "is_strict", (str(int(s)) for s in events.strict)),
        "/* Relations that stand for sample(), whose first instant is after initialisation, */",
        _table("unsigned char", "is_clock", _flags(dae.clock_relations, dae)),
        "/* and for initial(), which holds until then. */",
        _table("unsigned char", "is_initial", _flags(dae.initial_relations, dae)),
        "/* When-conditions that are initial(), and messages of those that terminate. */",
        _table("unsigned char", "at_start", (str(int(a)) for a in events.at_start)),
        _table("char *const", "terminates", map(_c_string, events.terminates)),
        _table("char *const", "assertion_messages", (_c_string(a.message) for a in dae.assertions)),
        "/* Unknowns of nonlinear blocks. */",
        _table("int", "loop_sizes", map(str, model.loop_sizes)),
        _table("char *const", "loop_names", (f'"{name}"' for name in model.loop_names)),
        _table("double", "loop_starts", (repr(s) for s, _ in _guesses(model))),
        _table("double", "loop_nominals", (repr(n) for _, n in _guesses(model))),
        "/* States that the initial equations determine. */",
        _table("int", "initial_states", map(str, initial.states)),
    ]


def _flags(chosen: Collection[int], dae: Dae) -> list[str]:
    return [str(int(i in chosen)) for i in range(len(dae.relations))]


def _guesses(model: ExplicitModel) -> list[tuple[float, float]]:
    """Start and nominal value of each unknown of a nonlinear block."""
    dae = model.dae
    found: list[tuple[float, float]] = []
    for name in model.loop_names:
        variable = dae.variables.get(name)
        start = dae.number(variable.start, 0.0) if variable is not None else 0.0
        nominal = abs(dae.number(variable.nominal, 1.0)) if variable is not None else 1.0
        found.append((start, nominal or 1.0))
    return found


def _c_string(text: str) -> str:
    """Return text as a C string literal, other than ASCII as octal escapes of UTF-8.

    Example:
        >>> print(_c_string('a "b"'))
        "a \\042b\\042"
    """
    plain = (
        chr(b) if 32 <= b < 127 and chr(b) not in '"\\?' else f"\\{b:03o}" for b in text.encode()
    )
    return f'"{"".join(plain)}"'


def _table(kind: str, name: str, entries: Iterable[str]) -> str:
    rows = list(entries) or ["0"]  # C has no empty arrays
    return f"static const {kind} model_{name}[] = {{{', '.join(rows)}}};"


def _functions(
    model: ExplicitModel, layout: Layout, events: EventSystem, initial: InitialSystem
) -> list[ca.Function]:
    names = ["time", "states", "inputs", "parameters", "discrete", "delayed", "relations", "loops"]
    at = [model.time, model.x, model.u, model.p, model.discrete, model.delayed, model.relations]
    at.append(model.loops)
    others = ca.vertcat(*(e for _, e in layout.others)) if layout.others else ca.SX(0, 1)
    computed = ca.vertcat(model.derivatives, others)

    seeds = [ca.SX.sym(f"seed_{k}", v.shape[0]) for k, v in zip("xup", at[1:4], strict=True)]
    seed_names = ("seed_states", "seed_inputs", "seed_parameters")

    def along_seeds(expression: SX) -> SX:
        return model.along(expression, ca.vertcat(*at[1:4]), ca.vertcat(*seeds))

    start_seed = ca.SX.sym("start_seed", layout.settable_starts.shape[0])
    start_change = ca.jtimes(
        layout.computed_starts,
        ca.vertcat(model.p, layout.settable_starts),
        ca.vertcat(seeds[2], start_seed),
    )

    operands = _column([model.fold(delay.operand) for delay in model.dae.delays])
    durations = _column([model.fold(delay.duration) for delay in model.dae.delays])
    input_slopes = ca.SX.sym("input_slopes", model.u.shape[0])
    directions = ca.vertcat(1.0, model.derivatives, input_slopes)
    slopes = model.along(operands, ca.vertcat(model.time, model.x, model.u), directions)

    def of_situation(name: str, results: dict[str, SX], **further: SX) -> ca.Function:
        arguments = [*at, *further.values()]
        # Outside when-clauses, a value and its value before the last event are the same.
        settled = [ca.densify(_settled(model, result)) for result in results.values()]
        return ca.Function(f"model_{name}", arguments, settled, [*names, *further], [*results])

    return [
        of_situation("derivatives", {"derivatives": model.derivatives}),
        of_situation("others", {"others": others}),
        of_situation("indicators", {"indicators": events.indicators}),
        of_situation("triggers", {"triggers": events.triggers}),
        of_situation("actions", {"after": events.after}, fired=events.fired),
        of_situation("assertions", {"assertions": events.assertions}),
        of_situation(
            "loops",
            {
                "residual": model.loop_residual,
                "jacobian": ca.jacobian(model.loop_residual, model.loops),
            },
        ),
        of_situation("initial", {"residual": initial.residual, "jacobian": initial.jacobian}),
        of_situation("delays", {"operands": operands, "slopes": slopes}, rates=input_slopes),
        *(
            of_situation(
                name,
                {"change": along_seeds(expression)},
                **dict(zip(seed_names, seeds, strict=True)),
            )
            for name, expression in (
                ("directional", computed),
                ("indicators_directional", events.indicators),
                ("initial_directional", initial.residual),
            )
        ),
        ca.Function(
            "model_start_directional",
            [model.p, layout.settable_starts, seeds[2], start_seed],
            [ca.densify(start_change)],
            ["parameters", "set", "seed_parameters", "seed_set"],
            ["change"],
        ),
        ca.Function(
            "model_start",
            [model.p, layout.settable_starts],
            [ca.densify(layout.computed_starts)],
            ["parameters", "set"],
            ["start"],
        ),
        ca.Function(
            "model_durations", [model.p], [ca.densify(durations)], ["parameters"], ["durations"]
        ),
    ]


def _column(parts: Sequence[SX]) -> SX:
    return ca.vertcat(*parts) if parts else ca.SX(0, 1)


def _settled(model: ExplicitModel, expression: SX) -> SX:
    if not model.previous_names:
        return expression
    now = ca.vertcat(*(model.value(name) for name in model.previous_names))
    return ca.substitute(expression, model.previous, now)


def _c_functions(functions: Sequence[ca.Function]) -> str:
    """Let CasADi write C; of its text, keep the function bodies and make everything static.

    What is left out are the functions by which CasADi itself loads compiled code; left as they
    are, public names could also clash with those of other libraries in the same process.
    """
    generator = ca.CodeGenerator(
        "model", {"casadi_int": "int", "with_export": False, "with_header": False}
    )
    for function in functions:
        generator.add(function)
    text = generator.dump()
    # Scalar code keeps its intermediate results on the stack; the runtime passes no work space.
    assert re.search(r"\bi?w\[", text) is None
    text = re.sub(r"#ifdef CASADI_CODEGEN_PREFIX.*?#endif\n", _PREFIX, text, flags=re.DOTALL)
    text = re.sub(r"#define casadi_[fs]\d+ .*\n", "", text)
    pieces = (_static(piece) for piece in re.split(r"\n\n+", text))
    return "\n\n".join(piece for piece in pieces if piece)


def _static(piece: str) -> str:
    """Return a top-level piece of CasADi's text as static code; nothing if it is not needed."""
    body = re.match(r"/\* (model_\w+):", piece)
    if body is not None:
        # CasADi numbers the bodies; each gets the name of its function.
        return re.sub(r"static int casadi_f\d+\(", f"static int {body[1]}(", piece)
    if re.match(r"casadi_real casadi_\w+\(", piece):
        return "static " + piece
    # Everything else is for CasADi's own loader: sizes, names, patterns, versions.
    is_needed = piece.startswith(("#", "/* How to prefix", "/* Add prefix"))
    return piece if is_needed else ""


_PREFIX = "#define CASADI_PREFIX(name) model_##name\n"
