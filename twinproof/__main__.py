"""`python -m twinproof` is the command."""

from twinproof.cli import main

main()
