"""`python -m twinproof` is the command."""

from twinproof.cli import command

command(prog_name="twinproof")
