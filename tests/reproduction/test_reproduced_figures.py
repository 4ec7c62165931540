"""What the reproduction pages rest on, against the print."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.signal import TransferFunction, impulse

from docs.reproduce import (
    furuta_control,
    furuta_identification,
    furuta_loop,
    furuta_report,
    wheeled_pendulum,
)
from docs.reproduce.page import POINTS, Page, curve
from examples import make_demo_recording as demo
from tests.identification import furuta_truth as truth


@pytest.fixture(scope="module")
def quiet():
    """The paper's aggressive command without noise, 20 s."""
    return demo.simulate(ideal_sensors=True)


@pytest.mark.parametrize(("case", "room"), [("A", 0.4), ("B", 0.6), ("C", 0.1)])
def test_table_3(quiet, case, room):
    tau, deviation, printed = wheeled_pendulum.PRINTED_TABLE_3[case]
    believed = np.array([0.0, deviation, 0.0, 0.0])
    found = wheeled_pendulum.filtered(quiet, (tau, tau), initial=believed)
    errors = 100 * np.abs(found / wheeled_pendulum.X - 1)
    np.testing.assert_allclose(errors, printed, atol=room)


def test_differencing_of_table_1():
    run = demo.simulate(reference=demo.simple, seed=1)
    np.testing.assert_allclose(
        wheeled_pendulum.direct(run)[4:], wheeled_pendulum.PRINTED_DIRECT[4:], rtol=0.12
    )


def test_impulse_response_of_the_filter():
    time = np.linspace(0, 3, 301)
    for tau in ((0.2, 0.5), (0.3, 0.3)):
        h, slope = wheeled_pendulum._impulse(tau, time)
        system = TransferFunction([1.0], np.polymul([tau[0], 1.0], [tau[1], 1.0]))
        _, expected = impulse(system, T=time)
        np.testing.assert_allclose(h, expected, atol=1e-9)
        np.testing.assert_allclose(slope[1:-1], np.gradient(h, time)[1:-1], atol=8e-3)


@pytest.mark.parametrize("name", ["simple", "aggressive"])
def test_errors_of_figure_5(name):
    exact = wheeled_pendulum.closed_loop(wheeled_pendulum.X.tolist(), demo.aggressive)
    found = wheeled_pendulum.closed_loop(wheeled_pendulum.PRINTED_FILTER[name], demo.aggressive)
    rms = np.sqrt(np.mean((found.states - exact.states) ** 2, axis=0))
    # The wheel's angle drifts, and depends on how the print's controller was discretised.
    room = (0.12, 0.03, 0.03, 0.03)
    for got, printed, tolerance in zip(rms, wheeled_pendulum.PRINTED_RMSE[name], room, strict=True):
        assert got == pytest.approx(printed, rel=tolerance)


def test_linear_model_of_the_rotary_pendulum():
    """(5.4), and the poles of both setups to the fourth digit."""
    A, B = furuta_control.linear(0)
    np.testing.assert_allclose(A[1], [0, -6.1, 8.1, -0.021], rtol=0.012, atol=1e-12)
    np.testing.assert_allclose(A[3], [0, -4.7, 55.5, -0.14], rtol=0.02, atol=1e-12)
    np.testing.assert_allclose(B.ravel(), [0, 1.32, 0, 1.01], rtol=0.005)
    printed = (
        (furuta_report.K_1, [0.9868 + 0.0172j, 0.9372, 0.8731 + 0.3352j]),
        (furuta_report.K_2, [0.9885 + 0.0162j, 0.9186, 0.9093 + 0.2585j]),
    )
    for setup, (K, poles) in enumerate(printed):
        Ai, Bi = furuta_control.incremental(*furuta_control.linear(setup))
        closed = np.linalg.eigvals(Ai - Bi @ np.array([K]))
        for pole in poles:
            assert np.min(np.abs(closed - pole)) < 4e-4
        dirty = furuta_control.dirty_poles(*furuta_control.linear(setup), K)
        assert np.abs(dirty).max() < 1


def test_the_dirty_derivative_moves_the_fast_pair():
    poles = furuta_control.dirty_poles(*furuta_control.linear(0), (*furuta_report.K_1[:4], 0.16))
    assert np.min(np.abs(poles - (0.898 + 0.353j))) < 2e-3


@pytest.mark.parametrize(
    ("stiction", "with_u", "expected"),
    [
        (0, False, (0.0042, 0.0239, 0.0268)),
        (0, True, (0.0035, 0.0229, 0.0300)),
        (45, False, (0.0042, 0.0256, 0.0143)),
        (45, True, (0.0035, 0.0241, 0.0217)),
    ],
)
def test_least_squares_as_published(stiction, with_u, expected):
    plant = truth.SETUP_1.sticky(stiction)
    record = truth.record(plant, truth.pulses(10.0, (0.5, 1.5, 50.0)), 1)
    found = furuta_identification.least_squares(plant, record, with_u=with_u)
    np.testing.assert_allclose(found, expected, rtol=0.06)


def test_swing_up_catches_and_keeps():
    run = furuta_loop.swing_up()
    caught = run.time[int(np.argmax(run.balancing))]
    assert 3 < caught < 7
    assert np.all(run.balancing[run.time >= caught])
    assert np.abs(run.tilt[run.time > caught + 2]).max() < np.deg2rad(5)


def test_balance_with_friction():
    plants = (truth.Setup(Kf=0.0), truth.SETUP_1, truth.SETUP_1.sticky())
    for plant, expected in zip(plants, (0.18, 0.5, 1.0), strict=True):
        run = furuta_loop.balance(furuta_loop.Balance(plant), np.deg2rad(8))
        late = np.rad2deg(run.tilt[run.time > 10])
        assert np.sqrt(np.mean(late**2)) == pytest.approx(expected, rel=0.3)


def test_a_page_holds_its_tables_and_pictures(tmp_path):
    page = Page(tmp_path / "out", "page")
    page.table(("|a|", "b"), [("1", "2"), ("3", "|")])
    page.picture("p", "A curve.", 1, 2, lambda axes: curve(axes[1], np.arange(3.0), np.ones(3)))
    text = page.write().read_text()
    assert text.startswith("| \\|a\\| | b |\n|---|---|\n| 1 | 2 |\n| 3 | \\| |\n")
    assert "![A curve.](page/p.svg)" in text
    first = (tmp_path / "out" / "page" / "p.svg").read_bytes()
    page.picture("p", "A curve.", 1, 2, lambda axes: curve(axes[1], np.arange(3.0), np.ones(3)))
    assert (tmp_path / "out" / "page" / "p.svg").read_bytes() == first


def test_a_long_curve_keeps_its_peaks():
    values = np.random.default_rng(1).normal(size=20_001)
    axis = Figure().subplots()
    curve(axis, np.arange(values.size), values)
    drawn = axis.lines[0].get_ydata()
    assert len(drawn) <= POINTS
    assert (drawn.min(), drawn.max()) == (values.min(), values.max())
