"""Tables of the Modelica Standard Library against NumPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.casadi_expressions import evaluate
from fmus.expressions import Literal, Relation, Symbol, walk
from fmus.tables import PREFIX, table_value

ONE = f"{PREFIX}CombiTable1D_getValue"
TIMES = f"{PREFIX}CombiTimeTable_getValue"
LINEAR, AKIMA, CONSTANT = 1, 2, 3
HOLD, LAST_TWO, PERIODIC = 1, 2, 3


def table(data, *, columns=(2,), smoothness=LINEAR, extrapolation=HOLD):
    return {
        "data": data,
        "columns": list(columns),
        "smoothness": smoothness,
        "extrapolation": extrapolation,
    }


def value(function, known, u, column=1, event=None):
    arguments = (Literal(1), Literal(column), Symbol("u"))
    return evaluate(table_value(function, known, arguments, event), {"u": u})


@given(
    st.lists(st.floats(-100, 100), min_size=1, max_size=40, unique_by=lambda x: round(x, 3)),
    st.floats(-150, 150),
)
def test_linear_segments(abscissa, u):
    x = np.sort(np.round(abscissa, 3))
    y = np.sin(x)
    known = table(np.column_stack([x, 0 * x, y]).tolist(), columns=(3,))
    assert value(ONE, known, u) == pytest.approx(np.interp(u, x, y), abs=1e-9)


def test_extrapolation_and_constant_segments():
    data = [[0.0, 0.0], [1.0, 1.0], [2.0, 4.0]]
    beyond = table(data, extrapolation=LAST_TWO)
    assert [value(ONE, beyond, u) for u in (-1.0, 3.0)] == [-1.0, 7.0]
    held = table(data, smoothness=CONSTANT)
    assert [value(ONE, held, u) for u in (-1.0, 0.5, 1.0, 1.5, 5.0)] == [0, 0, 1, 1, 4]


def test_a_jump_in_time_takes_the_later_value_and_makes_events():
    data = [[0.0, 0.0, 5.0], [1.0, 1.0, 5.0], [1.0, 3.0, 6.0], [2.0, 4.0, 6.0]]
    known = table(data, columns=(2, 3))
    assert [value(TIMES, known, t) for t in (0.5, 1.0, 1.5, 3.0)] == [0.5, 3.0, 3.5, 4.0]
    assert [value(TIMES, known, t, column=2) for t in (0.5, 1.0)] == [5.0, 6.0]
    relations = []

    def event(comparison):
        relations.append(Relation(len(relations), comparison))
        return relations[-1]

    made = table_value(TIMES, known, (Literal(1), Literal(1), Symbol("u")), event)
    assert set(relations) <= set(walk(made))
    assert len(relations) == 3


def test_ends_of_a_table():
    known = table([[-2.0, 0.0], [3.0, 1.0]])
    ends = [
        table_value(PREFIX + name, known, (Literal(1),), None)
        for name in ("CombiTable1D_minimumAbscissa", "CombiTimeTable_maximumTime")
    ]
    assert ends == [Literal(-2.0), Literal(3.0)]


@pytest.mark.parametrize(
    ("function", "further", "message"),
    [
        (ONE, {"smoothness": AKIMA}, "smoothness"),
        (ONE, {"extrapolation": PERIODIC}, "extrapolation"),
        (f"{PREFIX}CombiTable2D_getValue", {}, "CombiTable2D"),
    ],
)
def test_what_is_refused(function, further, message):
    with pytest.raises(ValueError, match=message):
        value(function, table([[0.0, 0.0], [1.0, 1.0]], **further), 0.5)
