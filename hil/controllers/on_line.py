"""Data-driven pole placement on-line: an unknown plant, a gain from its last samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from foundation.errors import InputError
from hil.controllers.base import Controller
from identification.pole_placement.online import ONLINE, OnlineUpdate


@dataclass(kw_only=True)
class OnLine(Controller):
    """u = F x + v with F placed anew at every sample from the last samples, v a small dither.

    Attributes:
        poles: Desired poles z, as text, one a measured state.
        form: `two-step`, or `published` for Algorithm 1.
        window: Samples that a model is made of; 0: the form's own.
        dither: Half width of v, uniform, in the command's unit: without it nothing is learnt.
        seed: Of the dither.

    Raises:
        InputError: Poles or window do not fit; no such form.

    Reference:
        P. E. E. Shwe, dissertation, Kanazawa University (2017), chapter 4: x(0) = 6 degrees of
        tilt, F(0) = 0, v between -0.05 and 0.05.
    """

    kind: ClassVar[str] = "on-line"

    poles: tuple[str, ...]
    form: str = "two-step"
    window: int = 0
    dither: float = 0.05
    seed: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.form not in ONLINE:
            raise InputError(
                f"no form '{self.form}'", where="controller.form", remedy=f"use {', '.join(ONLINE)}"
            )
        self.start()

    def start(self) -> None:
        """Forget the plant."""
        poles = [complex(p.replace(" ", "").replace("i", "j")) for p in self.poles]
        settings = {"window": self.window} if self.window and self.form == "two-step" else {}
        self._online: OnlineUpdate = ONLINE[self.form](poles, len(self.commanded), **settings)
        self._rng = np.random.default_rng(self.seed)
        self._applied: list[float] | None = None

    def step(self, time: float, y: Sequence[float], r: Sequence[float]) -> tuple[float, ...]:
        """Return the commands."""
        x = [a - b for a, b in zip(y, r, strict=True)]
        model = self._online.update(x, self._applied)
        v = self._rng.uniform(-self.dither, self.dither, len(self.commanded))
        self._applied = [self.limited(u) for u in (model.F @ x + v).tolist()]
        return tuple(self._applied)
