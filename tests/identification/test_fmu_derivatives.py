"""A foreign FMU for Model Exchange is fitted with its own directional derivatives."""

import re
import zipfile

import numpy as np
import pandas as pd
import pytest

from fmus.black_box import black_box
from fmus.frontend import load
from fmus.package import export
from fmus.sources import library_class
from fmus.variational import has_sensitivities
from identification.fmu_shooting import FmuShooting
from identification.shooting import Shooting
from twinproof import Model, identify, read_recording

PLANTS = {
    "Pendulum": (["theta", "omega"], [0.4, -0.3], ["J", "mgl", "d"], 1.0, 1e-3),
    # Two coordinates that drive each other; its dry friction turns round within a sample, which the
    # midpoint of that sample does not see exactly.
    "FurutaPendulum": (["alpha", "beta"], [0.1, 0.3, 0.0, 0.5], ["J_z0", "C0", "C1"], 20.0, 1e-2),
}


def without(path, pattern, to):
    """Return an FMU with another model description."""
    changed = to / "changed.fmu"
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(changed, "w", zipfile.ZIP_DEFLATED) as new:
        for item in old.infolist():
            content = old.read(item)
            if item.filename == "modelDescription.xml":
                content = re.sub(pattern, b"", content, flags=re.DOTALL)
            new.writestr(item, content)
    return changed


@pytest.fixture(scope="module", params=PLANTS)
def exchanged(request, tmp_path_factory):
    """An FMU that offers Model Exchange alone; outside of the cache it is foreign."""
    folder = tmp_path_factory.mktemp("exchanged")
    source = library_class(f"Twinproof.Plants.{request.param}")
    export(source, folder / "both.fmu", fmi="2")
    fmu = without(folder / "both.fmu", rb"<CoSimulation .*?</CoSimulation>", folder)
    return source, fmu, PLANTS[request.param]


def test_derivatives_are_those_of_the_equations(exchanged):
    source, fmu, (outputs, x0, parameters, size, tolerance) = exchanged
    assert has_sensitivities(fmu)
    exact = Shooting(load(source), outputs, parameters)
    there = FmuShooting(black_box(fmu), outputs, parameters)
    order = [exact.state_names.index(name) for name in there.state_names]
    h = 2e-3
    inputs = size * np.sign(np.sin(7 * h * np.arange(300)))[:, None]
    values = load(source).parameter_values
    start = np.array(x0)
    a = exact.run(start, inputs, exact.parameter_vector(values), h, sensitivities=True)
    b = there.run(start[order], inputs, there.parameter_vector(values), h, sensitivities=True)
    columns = [*order, *range(exact.nx, exact.nx + len(parameters))]
    wanted = a.sensitivities[:, :, columns]
    sizes = np.max(np.abs(wanted), axis=(0, 1))
    np.testing.assert_allclose(b.outputs, a.outputs, atol=1e-5)
    np.testing.assert_allclose(b.sensitivities / sizes, wanted / sizes, atol=tolerance)


def test_without_derivatives_differences_do(exchanged, tmp_path):
    _, fmu, (outputs, x0, parameters, size, tolerance) = exchanged
    plain = without(fmu, rb'\sprovidesDirectionalDerivative="true"', tmp_path)
    assert not has_sensitivities(plain)
    h = 2e-3
    inputs = np.full((100, 1), 0.3 * size)
    found = [
        FmuShooting(box, outputs, parameters)
        .run(
            np.array(x0),
            inputs,
            np.array([box.parameter_values[n] for n in shooting.parameter_names]),
            h,
            sensitivities=True,
        )
        .sensitivities
        for box in (black_box(fmu), black_box(plain))
        for shooting in [FmuShooting(box, outputs, parameters)]
    ]
    sizes = np.max(np.abs(found[0]), axis=(0, 1))
    np.testing.assert_allclose(found[0] / sizes, found[1] / sizes, atol=2 * tolerance)


def test_a_fit_with_them(tmp_path):
    source = library_class("Twinproof.Plants.Pendulum")
    export(source, tmp_path / "both.fmu", fmi="2")
    fmu = without(tmp_path / "both.fmu", rb"<CoSimulation .*?</CoSimulation>", tmp_path)
    true = {"J": 0.2, "mgl": 3.5, "d": 0.1}
    shooting = Shooting(load(source), ["theta"], [])
    values = {**load(source).parameter_values, **true}
    h = 0.01
    tau = 1.2 * np.sign(np.sin(1.9 * h * np.arange(300)))
    run = shooting.run(np.array([0.3, 0.0]), tau[:, None], shooting.parameter_vector(values), h)
    theta = run.outputs[:, 0] + 1e-3 * np.random.default_rng(3).standard_normal(300)
    path = tmp_path / "swing.csv"
    pd.DataFrame({"time": h * np.arange(300), "tau": tau, "theta": theta}).to_csv(path, index=False)
    model = Model.of(str(fmu))
    found = identify(model, read_recording(path, model)).estimate
    for name, value in true.items():
        assert found.parameters[name].value == pytest.approx(
            value, abs=4 * found.parameters[name].sd
        )
        assert found.parameters[name].sd < 0.05 * value
