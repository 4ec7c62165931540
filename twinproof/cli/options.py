"""Options that several commands share, and what a command prints where."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from rich.console import Console
from rich.text import Text

from fmus.sources import check_libraries
from foundation.errors import InputError
from foundation.files import write_text
from foundation.progress import Progress, Spoken, silent
from twinproof.cli.completing import complete_data, complete_model

if TYPE_CHECKING:
    from recordings import Recording
    from twinproof.documents import Document
    from twinproof.model import Model

_PIPE_WIDTH = 150

F = TypeVar("F", bound=Callable[..., Any])


def _checked(
    _context: click.Context, _parameter: click.Parameter, folders: tuple[Path, ...]
) -> tuple[Path, ...]:
    return check_libraries(folders)


model_argument = click.argument("model", shell_complete=complete_model)
data_argument = click.argument("data", shell_complete=complete_data)
json_option = click.option(
    "--json", "json_path", metavar="FILE", help="Write the result as JSON ('-': standard output)."
)
report_option = click.option(
    "--report",
    "report_dir",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Write DIR/report.html, a self-contained page with pictures.",
)
modelica_path_option = click.option(
    "--modelica-path",
    "modelica_path",
    multiple=True,
    metavar="DIR",
    type=click.Path(path_type=Path),
    callback=_checked,
    help="Folder that holds a further Modelica library; may be repeated.",
)
param_option = click.option(
    "--param",
    "params",
    multiple=True,
    metavar="K=V",
    help="Value of a parameter in place of the declared one; may be repeated.",
)
horizon_option = click.option(
    "--horizon",
    default="auto",
    show_default=True,
    metavar="auto|free|S",
    help="Free simulation, or windows of S seconds; auto: free where it stays bounded, else 1 s.",
)
also_option = click.option(
    "--also",
    multiple=True,
    metavar="DATA2",
    shell_complete=complete_data,
    help="A further record of the same machine, fitted at once; may be repeated.",
)
free_option = click.option(
    "--free", metavar="P,…", help="Parameters to fit; by default all that are not declared known."
)


def data_options(function: F) -> F:
    """Add `--map` and `--dbc`."""
    path = click.Path(path_type=Path, dir_okay=False)
    function = click.option(
        "--dbc", type=path, metavar="FILE", help="DBC file that describes a CAN log."
    )(function)
    return click.option(
        "--map",
        "channel_map",
        type=path,
        metavar="FILE.toml",
        help="Which column or signal is which variable, with unit and sensor.",
    )(function)


def parse_params(params: tuple[str, ...]) -> dict[str, float]:
    """Read `K=V` words.

    Raises:
        InputError: A word is not of that form.

    Example:
        >>> parse_params(("M=95.1", "d_a=−39.9"))
        {'M': 95.1, 'd_a': -39.9}
    """
    values: dict[str, float] = {}
    for word in params:
        name, _, number = word.partition("=")
        try:
            # Copied from one of our tables, a number may have a typographic minus.
            values[name] = float(number.replace("−", "-"))
        except ValueError:
            raise InputError(
                f"'{word}' is not NAME=NUMBER", where="--param", remedy="write it like M=95.1"
            ) from None
    return values


def parse_priors(words: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    """Read `K=V±SD` or `K=V,SD` words.

    Raises:
        InputError: A word is not of that form, or names a parameter a second time.

    Example:
        >>> parse_priors(("M=95±0.5", "d=0.1,0.02"))
        {'M': (95.0, 0.5), 'd': (0.1, 0.02)}
    """
    priors: dict[str, tuple[float, float]] = {}
    for word in words:
        name, _, numbers = word.partition("=")
        try:
            value, sd = (float(number) for number in numbers.replace("±", ",").split(","))
        except ValueError:
            raise InputError(
                f"'{word}' is not NAME=VALUE±SD",
                where="--prior",
                remedy="write it like M=95.1±0.5 or M=95.1,0.5",
            ) from None
        if name in priors:
            raise InputError(
                f"two priors of {name}", where="--prior", remedy="give one for each parameter"
            )
        priors[name] = (value, sd)
    return priors


def read_verified(path: Path) -> dict[str, tuple[float, float]]:
    """Read value and standard deviation of every parameter that a record showed.

    Args:
        path: A document of `identify --json`.

    Raises:
        InputError: It cannot be read, or is no such document.
    """
    remedy = "give the file that `twinproof identify … --json FILE` wrote"
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))["parameters"]
        return {
            name: (float(row["value"]), float(row["sd"]))
            for name, row in rows.items()
            if row["identifiable"]
        }
    except OSError as error:
        raise InputError(
            f"{path} cannot be read: {error.strerror}", where="--verified", remedy=remedy
        ) from None
    except (ValueError, TypeError, KeyError, AttributeError):
        raise InputError(
            f"{path} is no document of identify", where="--verified", remedy=remedy
        ) from None


def parse_names(text: str | None) -> tuple[str, ...] | None:
    """Read a comma-separated list; None stays None."""
    if text is None:
        return None
    return tuple(name.strip() for name in text.split(",") if name.strip())


@dataclass(frozen=True)
class Request:
    """A model, a recording in its names and units, and how to go about them.

    Attributes:
        model: The MODEL.
        recording: The DATA.
        parameters: From `--param`.
        free: From `--free`; None for the default choice.
        read: Reads another recording with the same channel map and DBC.
        output: Where results go.
    """

    model: Model
    recording: Recording
    parameters: dict[str, float]
    free: tuple[str, ...] | None
    read: Callable[[str], Recording]
    output: Output


def journey(function: Callable[..., None]) -> Callable[..., None]:
    """Give a command MODEL, DATA and the options around them, handed over as one `Request`."""

    @wraps(function)
    def command(
        model: str,
        data: str,
        channel_map: Path | None,
        dbc: Path | None,
        params: tuple[str, ...],
        free: str | None,
        modelica_path: tuple[Path, ...],
        json_path: str | None,
        **rest: Any,
    ) -> None:
        from twinproof.api import read_recording
        from twinproof.model import Model

        chosen = Model.of(model, modelica_path)

        def read(word: str) -> Recording:
            return read_recording(word, chosen, channel_map=channel_map, dbc=dbc)

        request = Request(
            chosen, read(data), parse_params(params), parse_names(free), read, Output(json_path)
        )
        function(request, **rest)

    options = (
        data_argument,
        model_argument,
        data_options,
        free_option,
        param_option,
        modelica_path_option,
        json_option,
    )
    for option in options:
        command = option(command)
    return command


class Output:
    """Where a command's results go: tables to people, JSON to scripts, progress to a terminal.

    Args:
        json_path: `-`: only JSON on standard output; a file: tables on standard output as well.
    """

    def __init__(self, json_path: str | None = None) -> None:
        self._json_path = json_path
        # A pipe or a file has no width of its own: wide enough that no name is cut.
        width = None if sys.stdout.isatty() else _PIPE_WIDTH
        # No markup: brackets in what is printed are units, indices and ranges.
        self.console = Console(
            quiet=json_path == "-", highlight=False, markup=False, emoji=False, width=width
        )
        self._errors = Console(stderr=True, highlight=False, markup=False, emoji=False)

    def document(self, value: Document) -> None:
        """Write the JSON document, if one was asked for."""
        from twinproof.documents import dumps

        if self._json_path == "-":
            sys.stdout.write(dumps(value))
        elif self._json_path is not None:
            write_text(Path(self._json_path), dumps(value))

    def note(self, text: str) -> None:
        """Say something on standard error."""
        self._errors.print(f"twinproof: {text}", soft_wrap=True)

    @contextmanager
    def progress(self) -> Generator[Progress]:
        """Show what is being done and how long it will take, on a terminal only."""
        # With JSON on standard output somebody's program is asking, whatever the terminal.
        if not self._errors.is_terminal or self._json_path == "-":
            yield silent
            return
        with self._errors.status("starting") as status:
            yield Spoken(lambda text: status.update(Text(text)))


def command_line() -> str:
    """Return the command as typed, for "how to repeat this"."""
    return "twinproof " + " ".join(shlex.quote(word) for word in sys.argv[1:])
