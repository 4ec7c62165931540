"""What the loop recorded goes straight into the diagnosis, which names what the plant hides."""

from pathlib import Path

import pytest

import twinproof
from hil.bus import bundled_dbc
from hil.rig import run_scenario
from hil.scenario import read_scenario

BALANCE = Path(__file__).parents[2] / "examples" / "hil" / "balance.toml"
REFERENCE = """amplitudes = ["6 deg", "6 deg", "4 deg"]
frequencies = [1.0, 4.0, 7.0]"""


def test_a_hidden_friction_is_named_from_the_loops_own_log(tmp_path):
    model = twinproof.Model.of("Twinproof.Plants.WheeledPendulum")
    real = twinproof.extend(model, ["CoulombFriction@wheel,tau_c=25"]).source
    (tmp_path / "Real.mo").write_text(real.text)
    text = BALANCE.read_text().replace(
        "Twinproof.Plants.WheeledPendulum", f"Real.mo:{real.class_name}"
    )
    text = text.replace('amplitudes = ["20 deg"]\nfrequencies = [1.0]', REFERENCE)
    path = tmp_path / "hidden.toml"
    path.write_text(text)
    run_scenario(read_scenario(path), recording=tmp_path / "run.blf")
    record = twinproof.read_recording(
        tmp_path / "run.blf", model, dbc=bundled_dbc("WheeledPendulum")
    )
    found = twinproof.diagnose(model, record).diagnosis
    assert found.ranking[0].label == "CoulombFriction@wheel"
    assert found.chosen is not None
    assert found.ranking[0].parameters["tau_c"][0] == pytest.approx(25, rel=0.05)
