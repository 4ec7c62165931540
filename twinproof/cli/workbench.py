"""`workbench`: the journey in a browser."""

from __future__ import annotations

import asyncio
import contextlib
import webbrowser
from pathlib import Path

import click


@click.command()
@click.argument(
    "folder",
    metavar="[DIR]",
    default=Path(),
    type=click.Path(path_type=Path, file_okay=False),
)
@click.option(
    "--port",
    default=8765,
    show_default=True,
    type=click.IntRange(0, 65535),
    help="0: any free one.",
)
@click.option("--no-browser", is_flag=True, help="Only say the address.")
def workbench(folder: Path, port: int, no_browser: bool) -> None:
    """Compare, diagnose, add and score in a browser; the project is plain files in DIR.

    DIR is the current folder by default. The server answers this machine only; Ctrl-C ends it.

    \b
    Example:
      twinproof workbench my-axis
    """
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(_serve(folder, port, not no_browser))


async def _serve(folder: Path, port: int, browser: bool) -> None:
    from twinproof.workbench.project import Project
    from twinproof.workbench.server import serve

    ready: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    serving = asyncio.create_task(serve(Project(folder.resolve()), port, ready))
    await asyncio.wait({serving, ready}, return_when=asyncio.FIRST_COMPLETED)
    if ready.done():
        click.echo(f"the workbench is at {ready.result()}; Ctrl-C ends it")
        if browser:
            webbrowser.open(ready.result())
    await serving
