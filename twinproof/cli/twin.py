"""`twin …`: the monitoring service, and what is asked of it."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from foundation.errors import InputError, UnknownNameError
from twin.client import Client, ServiceSilentError
from twinproof.cli.options import Output, json_option, modelica_path_option
from twinproof.cli.twin_jetstream import gateway_command, worker_command
from twinproof.cli.twin_replay import replay_command
from twinproof.documents import document

_URL = "http://127.0.0.1:8460"
_CONFIG = click.argument("config", type=click.Path(path_type=Path, dir_okay=False))

_url_option = click.option(
    "--url",
    default=lambda: os.environ.get("TWINPROOF_URL", _URL),
    show_default=_URL,
    help="Of the service; or TWINPROOF_URL.",
)
_token_option = click.option(
    "--token-file",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Holds the token to show; or TWINPROOF_TOKEN.",
)


@click.group()
def twin() -> None:
    """Twins of running plants: drift, re-verification, and the gate before deployment."""


def _client(url: str, token_file: Path | None) -> Client:
    token = os.environ.get("TWINPROOF_TOKEN", "")
    if token_file is not None:
        try:
            token = token_file.read_text(encoding="utf-8").strip()
        except OSError as error:
            raise InputError(
                f"the token cannot be read: {error.strerror}",
                where=str(token_file),
                remedy="correct --token-file",
            ) from error
    return Client(url, token)


@twin.command("serve")
@_CONFIG
@modelica_path_option
def serve(config: Path, modelica_path: tuple[Path, ...]) -> int:
    """Run the service that CONFIG.toml describes, until SIGINT or SIGTERM; SIGHUP reloads it.

    \b
    Example:
      twinproof twin serve line-3.toml
    """
    from twin import logs
    from twin.api import serve as serve_api
    from twin.live import live_service

    logs.set_up()
    with live_service(config, modelica_path) as service:
        serve_api(service)
    return 0


@twin.command("status")
@click.option("--twin", "name", metavar="NAME", help="One twin in full.")
@_url_option
@_token_option
@json_option
def status(name: str | None, url: str, token_file: Path | None, json_path: str | None) -> int:
    """How the twins of a running service are.

    \b
    Example:
      twinproof twin status --twin robot --json -
    """
    output = Output(json_path)
    client = _client(url, token_file)
    if name is None:
        found = client.get("/twins")
        table = Table(title="twins", title_justify="left")
        for heading in ("twin", "plant", "gate", "because"):
            table.add_column(heading)
        for t in found["twins"]:
            table.add_row(t["name"], t["state"], _word(t["gate"]), t["gate"]["because"])
        output.console.print(table)
        output.document(document("twin-status", found))
        return 0
    shown = client.get(f"/twins/{name}")
    events = client.get(f"/events?twin={name}&limit=20")["events"]
    output.console.print(f"{name}: {shown['state']}, gate {_word(shown['gate'])}")
    output.console.print(shown["gate"]["because"])
    table = Table(title="parameters", title_justify="left")
    for heading in ("parameter", "value", "sd", "verified", "unit"):
        table.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right")
    for key, p in shown["parameters"].items():
        verified = None if p["verified"] is None else p["verified"]["value"]
        table.add_row(key, _number(p["value"]), _number(p["sd"]), _number(verified), p["unit"])
    output.console.print(table)
    gate = shown["gate"]
    output.document(
        document(
            "twin-status",
            {
                "state": shown["state"],
                "because": shown["because"],
                "gate": gate,
                "parameters": shown["parameters"],
                "drift": shown["drift"],
                "counts": shown["counts"],
                "events": events,
            },
        )
    )
    return 0


@twin.command("gate")
@click.option(
    "--controller",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="The controller that is to be deployed.",
)
@click.option("--twin", "name", required=True, metavar="NAME", help="On which plant.")
@_url_option
@_token_option
@json_option
def gate(
    controller: Path, name: str, url: str, token_file: Path | None, json_path: str | None
) -> int:
    """May this controller be deployed on this plant now? Exit status 0: yes, 1: no.

    A service that does not answer is a no.

    \b
    Example:
      twinproof twin gate --controller pid.toml --twin robot && deploy pid.toml
    """
    from twin.verification import controller_hash

    output = Output(json_path)
    digest = controller_hash(controller)
    client = _client(url, token_file)
    try:
        found = client.get(f"/gate?twin={client.quoted(name)}&controller={digest}")
    except ServiceSilentError as error:
        found = _closed(str(error))
    output.console.print(f"{_word(found)}: {found['because']}")
    output.document(document("twin-gate", found))
    return 0 if found["allowed"] is True else 1


_twin_option = click.option("--twin", "name", required=True, metavar="NAME", help="Which twin.")


@twin.command("approve")
@_twin_option
@click.option(
    "--parameters",
    "wanted",
    metavar="ID",
    help="Beginning of the set's id; default: the newest that waits for approval.",
)
@_url_option
@_token_option
@json_option
def approve(
    name: str, wanted: str | None, url: str, token_file: Path | None, json_path: str | None
) -> int:
    """Put parameters that passed their verification into force, in your token's name.

    For twins with `approval = "token"`. The token needs the scopes read and approve.

    \b
    Example:
      twinproof twin approve --twin robot --token-file maria.token
    """
    client = _client(url, token_file)
    path = f"/twins/{client.quoted(name)}"
    waiting = [
        found["id"]
        for found in client.get(f"{path}/parameters")["sets"]
        if found["state"] == "candidate" and found["evidence"] is not None
    ]
    if not waiting:
        raise InputError(
            "no parameters wait for approval",
            where=name,
            remedy=f"see what the twin does: `twinproof twin status --twin {name}`",
        )
    meant = [found for found in waiting if found.startswith(wanted or "")]
    if not meant:
        raise UnknownNameError("parameter set that waits", str(wanted), waiting, where=name)
    if wanted is not None and len(meant) > 1:
        raise InputError(
            f"'{wanted}' begins the ids of {len(meant)} sets that wait",
            where=name,
            remedy="give more of the id: " + ", ".join(found[:12] for found in meant),
        )
    chosen = meant[0]
    done = client.post(f"{path}/approve", {"parameters": chosen})
    shown = client.get(path)["gate"]
    output = Output(json_path)
    output.console.print(f"{name}: parameters {chosen[:12]} are in force; {_sentence(shown)}")
    output.document(document("twin-approve", {**done, "gate": shown}))
    return 0


@twin.command("rollback")
@_twin_option
@_url_option
@_token_option
@json_option
def rollback(name: str, url: str, token_file: Path | None, json_path: str | None) -> int:
    """Put the parameters that were in force before into force again, in your token's name.

    The gate stays closed until the plant is verified anew. The token needs the scopes read and
    approve.

    \b
    Example:
      twinproof twin rollback --twin robot --token-file maria.token
    """
    client = _client(url, token_file)
    path = f"/twins/{client.quoted(name)}"
    done = client.post(f"{path}/rollback")
    to = next(e["detail"]["parameters"] for e in done["events"] if e["kind"] == "rolled_back")
    shown = client.get(path)["gate"]
    output = Output(json_path)
    output.console.print(f"{name}: parameters {to[:12]} are in force again; {_sentence(shown)}")
    output.document(document("twin-rollback", {**done, "gate": shown}))
    return 0


@twin.command("audit")
@_CONFIG
@json_option
def audit(config: Path, json_path: str | None) -> int:
    """Is the event log whole? Exit status 1 if anything was changed, removed or added.

    Reads the store and the key of CONFIG.toml; the service may run meanwhile.

    \b
    Example:
      twinproof twin audit line-3.toml
    """
    output = Output(json_path)
    with _store(config) as store:
        found = store.audit()
    word = "whole" if found.intact else f"NOT whole: {found.because}"
    output.console.print(f"{found.events} events, the log is {word}")
    output.document(document("twin-audit", vars(found)))
    return 0 if found.intact else 1


@twin.command("token")
@click.argument("name")
@click.option(
    "--file",
    "path",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("tokens.toml"),
    show_default=True,
    help="Of tokens; made if it is not there.",
)
@click.option(
    "--scope",
    "scopes",
    multiple=True,
    type=click.Choice(["read", "operate", "approve"]),
    default=("read",),
    show_default=True,
    help="What it may do; may be repeated.",
)
def token(name: str, path: Path, scopes: tuple[str, ...]) -> int:
    """Make a token for NAME and print it once; the file keeps its hash only.

    \b
    Example:
      twinproof twin token maria --scope read --scope approve
    """
    from twin.tokens import add_token

    click.echo(add_token(path, name, scopes))
    return 0


@twin.command("backup")
@_CONFIG
@click.option(
    "-o",
    "--output",
    "path",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Where it goes; whole or not at all.",
)
def backup(config: Path, path: Path) -> int:
    """Write all of the store to one file; the service may go on. The log's key is not in it.

    \b
    Example:
      twinproof twin backup line-3.toml -o line-3.backup.gz
    """
    from twin.store import back_up

    with _store(config) as store:
        rows = back_up(store.engine, path)
    click.echo(f"{rows} rows in {path}")
    return 0


@twin.command("restore")
@_CONFIG
@click.argument("backup_file", type=click.Path(path_type=Path, dir_okay=False))
def restore(config: Path, backup_file: Path) -> int:
    """Fill the new, empty store of CONFIG.toml from a backup of any kind of database.

    \b
    Example:
      twinproof twin restore line-3.toml line-3.backup.gz
    """
    from twin.store import open_database
    from twin.store import restore as fill

    service = _service_table(config)
    engine = open_database(service.store, config.parent)
    try:
        rows = fill(engine, backup_file)
    finally:
        engine.dispose()
    with _store(config) as store:
        store.begin_anew(time.time, f"restored from {backup_file.name}")
    click.echo(f"{rows} rows restored")
    return 0


def _service_table(config: Path) -> Any:
    from hil.settings import build, read_toml
    from twin.settings import ServiceSettings

    # The twins' models need not be compiled to look at a database.
    return build(ServiceSettings, read_toml(config).sub("service"))


def _store(config: Path) -> Any:
    from twin.store import Store

    service = _service_table(config)
    return Store.open(service.store, Path(service.key), config.parent)


def _closed(because: str) -> dict[str, Any]:
    return {"allowed": False, "because": because, "verified_at": None, "evidence": None}


def _word(gate: dict[str, Any]) -> str:
    return "open" if gate["allowed"] is True else "closed"


def _sentence(gate: dict[str, Any]) -> str:
    return f"the gate is {_word(gate)}: {gate['because']}"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.5g}"


for command in (replay_command, gateway_command, worker_command):
    twin.add_command(command)
