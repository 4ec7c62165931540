"""The command line: a thin layer over `twinproof`'s Python calls."""

from __future__ import annotations

import os
import sys
import traceback
from difflib import get_close_matches
from importlib import import_module
from importlib.metadata import version
from typing import NamedTuple

import click
from click.shell_completion import CompletionItem

from foundation.errors import TwinproofError


class _Home(NamedTuple):
    module: str
    says: str


# Where each command is, and the first line of its help: the list of commands and the completion of
# a shell must not wait for the numerical packages. A test keeps the lines in step.
_COMMANDS = {
    "compare": _Home("journey", "How well MODEL explains DATA, and where it fails."),
    "identify": _Home("journey", "Fit MODEL's parameters to DATA, with standard deviations."),
    "diagnose": _Home("journey", "Fit MODEL to DATA and find which physical effect it lacks."),
    "extend": _Home(
        "journey",
        "Write the Modelica class that has effects added to MODEL, or the system around an FMU.",
    ),
    "improve": _Home(
        "journey",
        "Compare, diagnose, add, refit, step by step; score on unseen data once at the end.",
    ),
    "workbench": _Home(
        "workbench",
        "Compare, diagnose, add and score in a browser; the project is plain files in DIR.",
    ),
    "demo": _Home(
        "demo", "Find the hidden effect in a bundled CAN log of a balancing wheeled pendulum."
    ),
    "data": _Home("data", "Measured data sets that are known by name."),
    "places": _Home("models", "Where effects can act on MODEL, with units."),
    "effects": _Home("models", "Which effects there are."),
    "simulate": _Home("models", "Run MODEL (Modelica, FMU or SSP) and write its outputs as CSV."),
    "export": _Home(
        "models", "Translate MODEL to an FMU (Co-Simulation and Model Exchange in one file)."
    ),
    "check": _Home(
        "models", "Try an FMU against a conformance list; exit status 1 if a line fails."
    ),
    "design": _Home(
        "design", "Plan an experiment that tells MODEL's parameters, or judge the one in DATA."
    ),
    "place-poles": _Home(
        "poles",
        "Data-driven pole placement: model and gain u = F x + v from states and inputs in DATA.",
    ),
    "hil": _Home("hil", "Hardware in the loop: controllers against a plant over a CAN bus."),
    "completion": _Home(
        "completion",
        "Print the script that makes a SHELL complete commands, options, MODEL and DATA.",
    ),
    "whatif": _Home("whatif", "Run STUDY.toml; exit status 1 if a run does not meet a criterion."),
    "twin": _Home(
        "twin", "Twins of running plants: drift, re-verification, and the gate before deployment."
    ),
}


class _Group(click.Group):
    """A group that imports a command when it is needed, and offers the nearest for a wrong one."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        home = _COMMANDS.get(cmd_name)
        if home is None:
            return None
        return getattr(import_module(f"twinproof.cli.{home.module}"), cmd_name.replace("-", "_"))

    def format_commands(
        self,
        ctx: click.Context,  # noqa: ARG002
        formatter: click.HelpFormatter,
    ) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, home.says) for name, home in _COMMANDS.items()])

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        commands = [
            CompletionItem(name, help=home.says)
            for name, home in _COMMANDS.items()
            if name.startswith(incomplete)
        ]
        return commands + click.Command.shell_complete(self, ctx, incomplete)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            near = get_close_matches(args[0], self.list_commands(ctx), n=1)
            if near:
                raise click.UsageError(f"{error.message} Did you mean '{near[0]}'?", ctx) from error
            raise


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(version("twinproof"), prog_name="twinproof")
def command() -> None:
    """Physical models against measurements: find the missing effect, add it, watch the error fall.

    \b
    MODEL  file.fmu | Twinproof.Plants.Positioner | file.mo:Class.Name
    DATA   a file (.csv .mat .log .blf, CAN logs with --dbc) | a registered set such as emps

    \b
    A first journey:
      twinproof compare Twinproof.Plants.Positioner emps
      twinproof improve Twinproof.Plants.Positioner emps --holdout emps-pulses -o out
    """


def main() -> None:
    """Run the command line; every outcome is an exit status, a user's mistake never a traceback."""
    try:
        status = command.main(prog_name="twinproof", standalone_mode=False)
    except TwinproofError as error:
        click.echo(f"twinproof: {error}", err=True)
        sys.exit(error.exit_status)
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except click.Abort:
        click.echo("twinproof: stopped", err=True)
        sys.exit(130)
    except BrokenPipeError:
        # The reader of our output (`head`, a pager) has what it wanted.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    except OSError as error:
        click.echo(f"twinproof: {error.strerror or error} ({error.filename or ''})", err=True)
        sys.exit(2)
    except Exception as error:
        if os.environ.get("TWINPROOF_TRACEBACK"):
            traceback.print_exc()
        click.echo(
            f"twinproof: a fault of ours: {type(error).__name__}: {error}; "
            "set TWINPROOF_TRACEBACK=1 to see where, and report it",
            err=True,
        )
        sys.exit(3)
    sys.exit(status if isinstance(status, int) else 0)
