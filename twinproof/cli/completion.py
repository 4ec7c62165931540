"""`completion`: the script that lets a shell complete commands, options, MODEL and DATA."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

_SHELLS = ("bash", "zsh", "fish")


@click.command()
@click.argument("shell", type=click.Choice(_SHELLS))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print the script that makes a SHELL complete commands, options, MODEL and DATA.

    \b
    Example:
      twinproof completion bash >> ~/.bashrc
      twinproof completion fish > ~/.config/fish/completions/twinproof.fish
    """
    kind = get_completion_class(shell)
    assert kind is not None, "click has these shells"
    # Not `source()`: for bash that asks which version is installed, here and not where it is used.
    script = kind(context.find_root().command, {}, "twinproof", "_TWINPROOF_COMPLETE")
    text = script.source_template % script.source_vars()
    click.echo(_for_bash(text) if shell == "bash" else text)


def _for_bash(script: str) -> str:
    """Let words have colons, as in file.mo:Class, and typing go on behind a folder's name."""
    end = "    return 0\n"
    assert end in script, "click's script has another end"
    open_folder = "[[ ${#COMPREPLY[@]} == 1 && ${COMPREPLY[0]} == */ ]] && compopt -o nospace"
    return "COMP_WORDBREAKS=${COMP_WORDBREAKS//:}\n" + script.replace(
        end, f"    {open_folder} 2>/dev/null\n{end}"
    )
