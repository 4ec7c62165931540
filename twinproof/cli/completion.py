"""`completion`: the script that lets a shell complete commands and options."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

_SHELLS = ("bash", "zsh", "fish")


@click.command()
@click.argument("shell", type=click.Choice(_SHELLS))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print the script that makes a SHELL complete commands and options.

    \b
    Example:
      twinproof completion bash >> ~/.bashrc
      twinproof completion fish > ~/.config/fish/completions/twinproof.fish
    """
    kind = get_completion_class(shell)
    assert kind is not None, "click has these shells"
    # Not `source()`: for bash that asks which version is installed, here and not where it is used.
    script = kind(context.find_root().command, {}, "twinproof", "_TWINPROOF_COMPLETE")
    click.echo(script.source_template % script.source_vars())
