"""The command line's help: quick, complete, and it forgives a slip of the pen."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner

from identification.estimators import ESTIMATORS
from recordings import list_sets
from recordings.readers import READERS
from twinproof.cli import command
from twinproof.cli.completing import DATA_SUFFIXES, METHODS

CONTEXT = click.Context(command, info_name="twinproof")
NAMES = command.list_commands(CONTEXT)


def commands() -> list[tuple[str, click.Command]]:
    """Return every command and every command of a group, with its words."""
    found: list[tuple[str, click.Command]] = []
    for name in NAMES:
        one = command.get_command(CONTEXT, name)
        assert one is not None
        if isinstance(one, click.Group):
            found += [(f"{name} {sub}", c) for sub, c in one.commands.items()]
        else:
            found.append((name, one))
    return found


def test_the_list_of_commands_says_what_each_one_says() -> None:
    listed = CliRunner().invoke(command, ["--help"]).output
    for name in NAMES:
        one = command.get_command(CONTEXT, name)
        assert one is not None
        assert one.help
        said = {item.value: item.help for item in command.shell_complete(CONTEXT, name)}
        assert said[name] == one.help.strip().splitlines()[0]
        assert f"  {name} " in listed


@pytest.mark.parametrize(("words", "one"), commands(), ids=lambda v: v if type(v) is str else "")
def test_every_command_has_an_example_and_explains_its_options(
    words: str, one: click.Command
) -> None:
    assert one.help
    assert f"twinproof {words} " in one.help or f"twinproof {words}\n" in f"{one.help}\n"
    for option in one.params:
        if isinstance(option, click.Option):
            assert option.help, f"{words} {option.opts}"


@pytest.mark.parametrize("words", [[], ["compare"], ["simulate"]])
def test_help_and_completion_do_not_wait_for_the_numerical_packages(words: list[str]) -> None:
    script = (
        "import sys; from twinproof.cli import command; from click.testing import CliRunner;"
        f"r = CliRunner().invoke(command, {[*words, '--help']});"
        "assert r.exit_code == 0, r.output;"
        "from click.shell_completion import ShellComplete;"
        "c = ShellComplete(command, {}, 'twinproof', '_X');"
        f"assert c.get_completions({words}, '');"
        "assert c.get_completions(['compare', 'm'], 'emps');"
        "slow = {'numpy', 'scipy', 'casadi', 'pandas', 'matplotlib'} & set(sys.modules);"
        "sys.exit(str(slow) if slow else 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_a_shell_completes_commands_and_options() -> None:
    completion = ShellComplete(command, {}, "twinproof", "_TWINPROOF_COMPLETE")
    assert [c.value for c in completion.get_completions([], "id")] == ["identify"]
    assert "--holdout" in [c.value for c in completion.get_completions(["improve"], "--")]


def offered(words: list[str], incomplete: str) -> list[str]:
    completion = ShellComplete(command, {}, "twinproof", "_TWINPROOF_COMPLETE")
    return [c.value for c in completion.get_completions(words, incomplete)]


def test_a_shell_completes_models_and_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "lab" / "Lab"
    (package / "Inner").mkdir(parents=True)
    (package / "package.mo").write_text("within ;\npackage Lab\nend Lab;\n")
    (package / "Axis.mo").write_text("within Lab;\nmodel Axis\nend Axis;\n")
    (package / "Inner" / "package.mo").write_text("within Lab;\npackage Inner\nend Inner;\n")
    (package / "Inner" / "Deep.mo").write_text("within Lab.Inner;\nmodel Deep\nend Deep;\n")
    (tmp_path / "two.mo").write_text(
        'package Two "no model Not"\n model A\n end A;\n model B\n end B;\nend Two;\n'
    )
    (tmp_path / "plant.fmu").touch()
    (tmp_path / "runs").mkdir()
    for name in ("one.BLF", "two.csv", "notes.txt", ".hidden.csv"):
        (tmp_path / "runs" / name).touch()
    monkeypatch.chdir(tmp_path)
    assert offered(["compare"], "Twinproof.Plants.P") == [
        "Twinproof.Plants.Pendulum",
        "Twinproof.Plants.Positioner",
    ]
    assert offered(["places"], "t") == ["two.mo:Two.A", "two.mo:Two.B"]
    assert offered(["places"], "two.mo:Two.B") == ["two.mo:Two.B"]
    assert offered(["compare"], "p") == ["plant.fmu"]
    assert offered(["check"], "") == ["lab/", "plant.fmu", "runs/"]
    found = offered(["compare", "--modelica-path", "lab"], "Lab.")
    assert found == ["Lab.Axis", "Lab.Inner.Deep"]
    assert offered(["compare", "two.mo"], "emps") == ["emps", "emps-pulses"]
    assert offered(["improve", "two.mo", "emps", "--holdout"], "runs/") == [
        "runs/one.BLF",
        "runs/two.csv",
    ]
    assert offered(["identify", "two.mo", "emps", "--also"], "ru") == ["runs/"]
    assert offered(["identify", "two.mo", "emps", "--method"], "out") == [
        "output-filter",
        "output-error",
    ]


def test_what_completion_offers_is_what_there_is() -> None:
    assert tuple(ESTIMATORS) == METHODS
    assert {s for r in READERS for s in r.suffixes} == set(DATA_SUFFIXES)
    assert [s.name for s in list_sets()] == offered(["compare", "m"], "")[: len(list_sets())]


def test_bash_takes_the_script_and_completes_with_it(tmp_path: Path) -> None:
    script = CliRunner().invoke(command, ["completion", "bash"])
    assert script.exit_code == 0
    (tmp_path / "twinproof").write_text(
        f"#!/bin/sh\nexec '{sys.executable}' -c 'from twinproof.cli import main; main()'\n"
    )
    (tmp_path / "twinproof").chmod(0o755)
    asked = "COMP_WORDS=(twinproof wo); COMP_CWORD=1; _twinproof_completion twinproof; "
    done = subprocess.run(
        ["bash", "-c", script.output + asked + 'echo "${COMPREPLY[@]}"'],
        env={**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == ["workbench"], done.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["comparr"], "Did you mean 'compare'"),
        (["data", "lst"], "Did you mean 'list'"),
        (["improve", "--holdut", "x"], "--holdout"),
    ],
)
def test_a_slip_of_the_pen_is_understood(words: list[str], said: str) -> None:
    result = CliRunner().invoke(command, words)
    assert result.exit_code == 2
    assert said in result.output
