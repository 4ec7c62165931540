"""Foreign FMUs: they run, and what they break stays broken on their side."""

import contextlib
import io
import stat
import struct
import threading
import time
import zipfile
from pathlib import Path

import foreign
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus.archive import check_archive, describe, extract
from fmus.checking import check_fmu
from fmus.guarded import Guard, Limits, is_ours, open_plant, simulate_guarded
from fmus.package import cached_fmu
from fmus.running import free_run, simulate, start_names
from fmus.sources import library_class
from fmus.wire import WireError, decode, encode
from foundation.errors import FmuError, InputError, TwinproofError, UnknownNameError


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("foreign")


@pytest.fixture(scope="module")
def in_c(folder):
    return foreign.hand_written(folder)


@pytest.fixture(scope="module")
def made_elsewhere(tmp_path_factory, in_c):
    pytest.importorskip("pythonfmu")
    pytest.importorskip("pythonfmu3")
    return {
        "c": in_c,
        "pythonfmu": foreign.by_pythonfmu(tmp_path_factory.mktemp("two")),
        "pythonfmu3": foreign.by_pythonfmu3(tmp_path_factory.mktemp("three")),
    }


def euler(rate, start, inputs, step):
    values = [start]
    for u in inputs[:-1]:
        values.append(values[-1] + step * rate * (u - values[-1]))
    return np.array(values)


@pytest.mark.parametrize(
    ("maker", "rate", "start"), [("c", 1.0, 0.0), ("pythonfmu", 2.0, 1.0), ("pythonfmu3", 2.0, 1.0)]
)
def test_foreign_fmus_run_in_a_child_and_give_their_values(made_elsewhere, maker, rate, start):
    fmu = made_elsewhere[maker]
    assert not is_ours(fmu)
    grid = np.arange(51) * 0.1
    u = np.sin(grid)
    run = simulate(fmu, inputs=(grid, {"u": u}))
    assert run["y"] == pytest.approx(euler(rate, start, u, 0.1), abs=1e-12)
    with open_plant(fmu) as plant:
        plant.run((grid[:21], {"u": u[:21]}))
        for k in range(20, 50):
            plant.set({"u": u[k]})
            assert plant.read()["y"] == pytest.approx(run["y"][k], abs=1e-12)
            plant.step(0.1)


def test_parameters_of_foreign_fmus(made_elsewhere):
    run = simulate(made_elsewhere["pythonfmu"], parameters={"rate": 5.0}, stop=1.0, step=0.1)
    assert run["y"] == pytest.approx(euler(5.0, 1.0, np.zeros(11), 0.1), abs=1e-12)


def test_state_of_a_guarded_plant(in_c):
    with open_plant(in_c) as plant:
        plant.set({"u": 1.0})
        state = plant.save()
        plant.step(0.1)
        first = plant.read()
        plant.rewind(state)
        assert plant.time == 0.0
        plant.step(0.1)
        assert plant.read() == first
        plant.forget(state)
        with pytest.raises(UnknownNameError):
            plant.set({"nothing": 1.0})
        with pytest.raises(FmuError, match="no directional derivatives"):
            plant.derivatives(["y"], ["u"])


@pytest.mark.parametrize(
    ("misdeed", "message"),
    [
        (1, "crashed with SIGSEGV"),
        (2, "did not answer within 3 s"),
        (3, "refused: step"),  # memory
        (4, "ended its process with status 7"),
        (5, "crashed with SIGXFSZ|refused: step"),  # a large file
        (6, "."),  # many open files
        (9, "."),  # nonsense on every descriptor, then the end
    ],
)
def test_misdeeds_are_messages(in_c, misdeed, message):
    run = {"parameters": {"misdeed": float(misdeed)}, "stop": 1.0, "step": 0.1}
    # Only what hangs must be given up soon; to fill a gigabyte takes a busy machine longer.
    seconds = 3.0 if misdeed == 2 else 60.0
    with Guard(Limits(memory=2**30, seconds=seconds)) as guard:
        with pytest.raises(FmuError, match=message):
            simulate_guarded(in_c, run, guard=guard)
        # The guard itself goes on.
        fine = simulate_guarded(in_c, {"stop": 1.0, "step": 0.1}, guard=guard)
        assert fine["columns"]["y"][-1] == 0.0


def test_no_network_where_the_child_says_so(in_c):
    run = {"parameters": {"misdeed": 7.0}, "stop": 0.1, "step": 0.1}
    with Guard() as guard:
        simulate_guarded(in_c, {"stop": 0.1, "step": 0.1}, guard=guard)
        if guard.has_network:
            pytest.skip("this system has no unprivileged network namespaces")
        with pytest.raises(FmuError, match="refused: step"):
            simulate_guarded(in_c, run, guard=guard)


def test_noise_on_standard_output_does_no_harm(in_c, capfd):
    simulate(in_c, parameters={"misdeed": 8.0}, stop=1.0, step=0.1)
    assert capfd.readouterr().out == ""


def test_the_child_is_replaced_after_some_runs(in_c):
    with Guard(Limits(runs=2)) as guard:
        for _ in range(5):
            simulate_guarded(in_c, {"stop": 0.2, "step": 0.1}, guard=guard)
        assert guard.starts == 3


def test_check_of_a_crashing_fmu_is_an_answer(tmp_path):
    fmu = foreign.hand_written(
        tmp_path,
        foreign.DESCRIPTION.replace('"tunable"><Real\n    start="0"', '"tunable"><Real start="1"'),
    )
    lines = {line.name: line for line in check_fmu(fmu)}
    assert lines["rules of the standard"]
    with pytest.raises(FmuError, match="crashed"):
        simulate(fmu, parameters={"misdeed": 1.0}, stop=1.0)


def test_check_of_foreign_fmus(made_elsewhere):
    for fmu in made_elsewhere.values():
        lines = check_fmu(fmu)
        assert {"runs as CoSimulation", "repeats itself", "reset starts anew"} <= {
            line.name for line in lines
        }
        assert {line.name for line in lines if not line.ok} <= {
            "rules of the standard",
            "reset starts anew",
            "values at the start",
        }, lines


def test_our_own_fmus_stay_in_this_process():
    assert is_ours(cached_fmu(library_class("Twinproof.Plants.Pendulum")))


# Archives


def archive_of(tmp_path, *entries, comment=b""):
    path = tmp_path / "a.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries:
            archive.writestr(name, content)
        archive.comment = comment
    return path


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_dangerous_archives_are_refused(tmp_path):
    def link(name):
        info = zipfile.ZipInfo(name)
        info.external_attr = (stat.S_IFLNK | 0o777) << 16
        return info

    good = ("modelDescription.xml", foreign.DESCRIPTION)
    bomb = '<!DOCTYPE a [<!ENTITY b "bbbb">]><fmiModelDescription>&b;</fmiModelDescription>'
    for entries, message in (
        ([("../out", "x")], "outside"),
        ([("/etc/out", "x")], "outside"),
        ([("a\\..\\..\\out", "x")], "outside"),
        ([("C:out", "x")], "outside"),
        ([(link("resources/x"), "/etc/passwd")], "link"),
        ([good, good], "two entries"),
        ([("modelDescription.xml", bomb)], "DTD"),
        ([("modelDescription.xml", bomb.encode("utf-16"))], "DTD"),
        ([("resources/zeros", bytes(50 * 2**20))], "times"),
    ):
        path = archive_of(tmp_path, *entries)
        for use in (check_archive, describe, lambda p: extract(p, tmp_path / "there")):
            with pytest.raises(FmuError, match=message):
                use(path)
        assert not (tmp_path / "there").exists()
    assert not (tmp_path.parent / "out").exists()


def test_the_sha256_is_pinned(in_c):
    with pytest.raises(FmuError, match="SHA-256"):
        simulate(in_c, stop=1.0, sha256="0" * 64)


def files_below(folder):
    return {p for p in folder.rglob("*") if p.is_file()}


SMALL = settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@SMALL
@given(data=st.data())
def test_mutated_archives(in_c, tmp_path, data):
    content = bytearray(in_c.read_bytes())
    # Most of what can go wrong stands in the directory at the end.
    for _ in range(data.draw(st.integers(1, 8))):
        where = data.draw(
            st.integers(0, len(content) - 1) | st.integers(len(content) - 200, len(content) - 1)
        )
        content[where] = data.draw(st.integers(0, 255))
    if data.draw(st.booleans()):
        content = content[: data.draw(st.integers(0, len(content)))]
    outer = tmp_path / "outer"
    outer.mkdir(exist_ok=True)
    path = outer / "m.fmu"
    path.write_bytes(content)
    target = outer / "target"
    target.mkdir(exist_ok=True)
    for use in (describe, lambda p: extract(p, target)):
        with contextlib.suppress(TwinproofError):
            use(path)
    assert {p for p in files_below(outer) if not p.is_relative_to(target)} == {path}
    assert sum(p.stat().st_size for p in files_below(target)) < 2**24


XML = foreign.DESCRIPTION
PIECES = ["<", ">", '"', "/", "&#0;", "&lt;", "99999999999", "-1", "NaN", "1e999", "\U0001f600", ""]


@SMALL
@given(data=st.data())
def test_mutated_descriptions(tmp_path, data):
    text = XML
    for _ in range(data.draw(st.integers(1, 4))):
        begin = data.draw(st.integers(0, len(text)))
        end = min(len(text), begin + data.draw(st.integers(0, 40)))
        piece = data.draw(
            st.sampled_from(PIECES) | st.just(text[begin:end] * 2) | st.text(max_size=5)
        )
        text = text[:begin] + piece + text[end:]
    path = archive_of(tmp_path, ("modelDescription.xml", text.encode("utf-8", "replace")))
    with contextlib.suppress(TwinproofError):
        describe(path)


def test_a_lying_size_does_not_fill_the_disk(tmp_path):
    path = archive_of(tmp_path, ("resources/zeros", bytes(2**26)))
    content = path.read_bytes()
    # The directory says 10 bytes; the packed data hold 64 MB.
    lied = content.replace(struct.pack("<I", 2**26), struct.pack("<I", 10))
    path.write_bytes(lied)
    with pytest.raises(FmuError):
        extract(path, tmp_path / "there")
    assert sum(p.stat().st_size for p in files_below(tmp_path / "there")) < 2**20


# Messages


def receiver(content):
    stream = io.BytesIO(content)

    def receive(size):
        got = stream.read(size)
        if len(got) < size:
            raise WireError("the end")
        return got

    return receive


def test_messages_come_back():
    message = {"a": np.arange(6.0).reshape(2, 3), "b": [1, None, {"c": "é"}], "d": np.empty((0, 2))}
    back = decode(receiver(b"".join(encode(message))))
    assert np.array_equal(back["a"], message["a"])
    assert back["d"].shape == (0, 2)
    assert back["b"] == message["b"]


@given(st.binary(max_size=64), st.binary(max_size=64))
def test_nonsense_is_refused(text, rest):
    try:
        decode(receiver(len(text).to_bytes(8, "little") + text + rest))
    except WireError:
        return


def test_requests_of_several_threads_do_not_mix(in_c):
    grid = np.arange(11) * 0.1
    got = {}

    def work(u):
        got[u] = simulate(in_c, inputs=(grid, {"u": np.full(11, u)}))["y"][-1]

    threads = [threading.Thread(target=work, args=(float(k),)) for k in range(6)]
    began = time.monotonic()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert time.monotonic() - began < 60
    for u, y in got.items():
        assert y == pytest.approx(u * (1 - 0.9**10), abs=1e-12)
    assert Path(in_c).exists()


def test_free_run_along_a_recording(made_elsewhere):
    grid = np.arange(51) * 0.1
    columns = {"u": np.sin(grid), "y": np.zeros(51), "spare": np.zeros(51)}
    run = free_run(made_elsewhere["pythonfmu"], grid, columns, parameters={"rate": 3.0})
    assert list(run.columns) == ["y"]
    assert run["y"] == pytest.approx(euler(3.0, 1.0, columns["u"], 0.1), abs=1e-12)
    with pytest.raises(InputError, match="no output"):
        free_run(made_elsewhere["c"], grid, {"u": columns["u"]})
    ours = cached_fmu(library_class("Twinproof.Plants.Pendulum"))
    assert start_names(ours) == {"theta": "theta_start", "omega": "omega_start"}
