"""The command line: a thin layer over `twinproof`'s Python calls."""

from __future__ import annotations

import os
import sys
import traceback
from difflib import get_close_matches
from importlib.metadata import version

import click

from foundation.errors import TwinproofError
from twinproof.cli.data import data
from twinproof.cli.demo import demo
from twinproof.cli.design import design
from twinproof.cli.hil import hil
from twinproof.cli.journey import compare, diagnose, extend, identify, improve
from twinproof.cli.models import check, effects, export, places, simulate
from twinproof.cli.poles import place_poles
from twinproof.cli.whatif import whatif


class _Group(click.Group):
    """A group that offers the nearest command for one that it does not know."""

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


for _command in (
    export,
    check,
    simulate,
    places,
    effects,
    compare,
    identify,
    diagnose,
    extend,
    improve,
    design,
    place_poles,
    hil,
    whatif,
    data,
    demo,
):
    command.add_command(_command)


def main() -> None:
    """Run the command line; every outcome is an exit status, a user's mistake never a traceback."""
    try:
        status = command.main(standalone_mode=False)
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
