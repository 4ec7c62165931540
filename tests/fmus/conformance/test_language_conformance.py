"""Every construct of the language in a model of its own: exported, validated, run, compared."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from conformance.references import REFERENCES, STOP
from conformance.refused import REFUSED
from conformance.table import table_of
from fmpy.validation import validate_fmu

from fmus import compiler
from fmus.explicit import explicit
from fmus.frontend import load
from fmus.package import export
from fmus.running import simulate
from fmus.sources import ModelicaSource
from foundation.errors import InputError

MODELS = Path(__file__).parent / "models"
NAMES = sorted(file.stem for file in MODELS.glob("*.mo"))
KINDS = ("CoSimulation", "ModelExchange")
DOCUMENT = Path(__file__).parents[3] / "docs" / "language.md"


def conformance_source(name):
    text = (MODELS / f"{name}.mo").read_text()
    return ModelicaSource(text, name, f"{name}.mo", f"{name}.mo:{name}")


@pytest.fixture(autouse=True)
def _compile_quickly(monkeypatch):
    """Compiling is most of the time, and slow code does for a second's simulation."""
    quick = partial(compiler.compile_library, flags=("-O0", "-fvisibility=hidden"))
    monkeypatch.setattr(compiler, "compile_library", quick)


def test_the_suite_is_complete():
    assert sorted(REFERENCES) == NAMES
    assert len(NAMES) >= 60


@pytest.mark.parametrize("fmi", ["2", "3"])
@pytest.mark.parametrize("name", NAMES)
def test_construct(name, fmi, tmp_path):
    fmu = tmp_path / f"{name}.fmu"
    export(conformance_source(name), fmu, fmi=fmi)
    assert validate_fmu(str(fmu)) == []
    stop = STOP.get(name, 1.2)
    times = np.linspace(0.0, stop, 21)
    expected = REFERENCES[name](times)
    for kind in KINDS:
        run = simulate(fmu, stop=stop, step=stop / 20, kind=kind, outputs=list(expected))
        for column, values in expected.items():
            known = np.isfinite(values)
            there, here = run[column][known], np.asarray(values, float)[known]
            assert there == pytest.approx(here, abs=1e-5, rel=1e-5), (kind, column)


@pytest.mark.parametrize("construct", REFUSED)
def test_construct_is_refused(construct):
    text, message = REFUSED[construct]
    with pytest.raises(InputError, match=message) as caught:
        explicit(load(ModelicaSource(text, "T", "T.mo", "T.mo")), freeze_relations=True)
    assert str(caught.value).startswith("T.mo:")


def test_the_table_in_the_documents_is_that_of_the_suite():
    """`python -m conformance.table` in tests/fmus writes it anew."""
    assert table_of(MODELS) in DOCUMENT.read_text(encoding="utf-8")
