"""`twin gateway`, `twin worker`: one service on several machines."""

from __future__ import annotations

import signal
from pathlib import Path
from types import FrameType

import click

from twinproof.cli.options import modelica_path_option

_CONFIG = click.argument("config", type=click.Path(path_type=Path, dir_okay=False))


@click.command("gateway")
@_CONFIG
@modelica_path_option
def gateway_command(config: Path, modelica_path: tuple[Path, ...]) -> int:
    """Record and publish the frames of all twins of CONFIG.toml, until SIGINT or SIGTERM.

    Runs at the machines; `twin worker` at any number of others follows the twins.

    \b
    Example:
      twinproof twin gateway line-3.toml
    """
    from twin import logs
    from twin.jetstream.connection import process_name
    from twin.jetstream.gateway import Gateway
    from twin.settings import read_settings

    logs.set_up()
    with Gateway(read_settings(config, roots=modelica_path), process_name()) as gateway:

        def stop(_signal: int, _frame: FrameType | None) -> None:
            gateway.stop()

        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, stop)
        gateway.start()
        gateway.wait()
    return 0


@click.command("worker")
@_CONFIG
@modelica_path_option
def worker_command(config: Path, modelica_path: tuple[Path, ...]) -> int:
    """Follow a share of the twins of CONFIG.toml, whose frames gateways publish.

    Any number of workers share the twins; those of one that is gone go on at the others. Serves
    the API as `twin serve` does, until SIGINT or SIGTERM; SIGHUP reloads.

    \b
    Example:
      twinproof twin worker line-3.toml
    """
    from twin import logs
    from twin.api import serve as serve_api
    from twin.live import live_worker

    logs.set_up()
    with live_worker(config, modelica_path) as worker:
        serve_api(worker)
    return 0
