"""`data list` and `data get`: the registered measured data."""

from __future__ import annotations

import click
from rich.table import Table

from recordings import fetch, list_sets
from twinproof.cli.options import Output, json_option
from twinproof.documents import document


@click.group()
def data() -> None:
    """Measured data sets that are known by name."""


@data.command("list")
@json_option
def list_command(json_path: str | None) -> None:
    """List the registered data sets.

    \b
    Example:
      twinproof data list
    """
    output = Output(json_path)
    sets = list_sets()
    table = Table()
    for heading in ("name", "what", "licence", "origin"):
        table.add_column(heading, overflow="fold")
    for s in sets:
        table.add_row(s.name, s.title, s.licence, s.repository)
    output.console.print(table)
    output.document(
        document(
            "data",
            {
                "sets": [
                    {
                        "name": s.name,
                        "title": s.title,
                        "licence": s.licence,
                        "origin": s.repository,
                        "commit": s.commit,
                    }
                    for s in sets
                ]
            },
        )
    )


@data.command("get")
@click.argument("name")
@json_option
def get(name: str, json_path: str | None) -> None:
    """Find or download a data set and say where it is.

    \b
    Looks in $TWINPROOF_DATA, then in the user's cache, then downloads it from its origin.
    Example:
      twinproof data get emps
    """
    output = Output(json_path)
    files = fetch(name)
    output.console.print(str(files.data), soft_wrap=True)
    output.document(document("data", {"sets": [{"name": name, "file": str(files.data)}]}))
