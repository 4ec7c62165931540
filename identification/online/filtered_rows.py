"""The rows of a filtered regression, sample by sample (`regressors.signals.filtered_rows`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import sympy as sp

from foundation.errors import ChannelError
from foundation.resumable import Resumable
from identification.output_filter import Array, OutputFilter
from identification.regressors.regression import Regression
from identification.regressors.sympy_fold import Sym

NUISANCE = 2
"""Columns of the filter's own transients, before the regression's."""


class StreamingRows(Resumable):
    """Forms the filtered equations of one sample after another.

    Args:
        regression: Derived from the model.
        output_names: Measured channels, in the order of `push`.
        tau: Time constants τ1, τ2 of the output filter [s].
        sample_time: Between samples [s].
        ramps: Which inputs run in straight lines between samples; others hold.
    """

    _changes = (
        "_state",
        "_first",
        "_last",
        "_slope",
        "_samples",
    )

    def __init__(
        self,
        regression: Regression,
        output_names: Sequence[str],
        tau: tuple[float, float],
        sample_time: float,
        ramps: Sequence[bool] = (),
    ) -> None:
        self._h = sample_time
        self._ramps = [k for k, ramp in enumerate(ramps) if ramp]
        self._positions = [
            _reading(regression, c.position.name, output_names) for c in regression.coordinates
        ]
        self._rates = [
            _reading(regression, c.rate.name, output_names)
            if c.rate.name in regression.readings
            else None
            for c in regression.coordinates
        ]
        symbols = [
            regression.time,
            *regression.inputs,
            *(c.position for c in regression.coordinates),
            *(c.rate for c in regression.coordinates),
        ]
        parts = [(t.phi2, t.phi1, t.phi0) for t in regression.terms]
        wanted = sorted(
            {(2 - k, phi) for part in parts for k, phi in enumerate(part) if phi != 0}, key=str
        )
        self._terms = _scalar(symbols, [phi for _, phi in wanted])
        # Only second derivatives pass a sample's own value on at once.
        self._direct = np.flatnonzero([order == 2 for order, _ in wanted])
        self._direct_terms = _scalar(symbols, [phi for order, phi in wanted if order == 2])
        self._differenced = bool(regression.differenced)
        self._shape = (len(regression.known), NUISANCE + len(regression.columns) + 1)
        self._to_rows = _selection(parts, wanted, self._shape)
        self._filter_matrices(wanted, OutputFilter(*tau, sample_time))
        self.restart()

    def _filter_matrices(self, wanted: Sequence[tuple[int, Sym]], low: OutputFilter) -> None:
        transition, gamma0, gamma1 = low.step
        # (x1, x2) of the next sample from (x1, x2, start, end).
        self._step = np.column_stack([transition, gamma0 - gamma1, gamma1])
        t1, t2 = low.tau1, low.tau2
        by_order = np.array(
            [
                [0.0, 1.0, 0.0],
                [1 / t2, -1 / t2, 0.0],
                [-1 / (t1 * t2) - 1 / t2**2, 1 / t2**2, 1 / (t1 * t2)],
            ]
        )
        orders = [order for order, _ in wanted]
        self._output = np.concatenate([by_order[orders], np.tile(by_order[0], (NUISANCE, 1))]).T
        self._derived = np.array(orders) > 0

    def restart(self) -> None:
        """Forget what was; the next sample is the first."""
        count = len(self._derived)
        self._state = np.zeros((4, count + NUISANCE))
        # The filter's two transients are the answers to these initial values.
        self._state[0, count + 1] = 1.0
        self._state[1, count] = 1.0
        self._first: Array | None = None
        self._last: list[float] = []
        self._slope = [0.0] * len(self._positions)
        self._samples = 0

    def push(self, inputs: Sequence[float], outputs: Sequence[float]) -> Array:
        """Take a sample.

        Returns:
            (equations, 2 + columns + 1): transients, columns, right-hand side; all but the
            transients are zero at the first sample.
        """
        time = self._samples * self._h
        values = [time, *inputs]
        positions = [(outputs[i] - offset) / gain for i, offset, gain in self._positions]
        values += positions
        if self._samples > 0 and self._differenced:
            self._slopes(positions)
        values += self._rates_now(outputs)
        if self._samples > 0:
            self._advance(values)
        count = len(self._derived)
        if self._differenced:
            # What else is needed of this sample is known with the next one.
            if self._first is not None:
                direct = np.array(self._direct_terms(values))
                self._state[2, self._direct] = direct - self._first[self._direct]
        else:
            start = np.array(self._terms(values))
            if self._first is None:
                self._first = np.where(self._derived, start, 0.0)
            self._state[2, :count] = start - self._first
        self._last = values
        self._samples += 1
        filtered = (self._output * self._state[:3]).sum(axis=0)
        if self._samples == 1:
            filtered[:count] = 0.0
        return (filtered @ self._to_rows).reshape(self._shape)

    def _rates_now(self, outputs: Sequence[float]) -> list[float]:
        held = self._slope if self._differenced else [0.0] * len(self._rates)
        return [
            held[j] if r is None else (outputs[r[0]] - r[1]) / r[2]
            for j, r in enumerate(self._rates)
        ]

    def _slopes(self, positions: Sequence[float]) -> None:
        first = len(self._last) - 2 * len(positions)
        before = self._last[first : first + len(positions)]
        self._slope = [(b - a) / self._h for a, b in zip(before, positions, strict=True)]

    def _advance(self, values: Sequence[float]) -> None:
        """Step the filter from the last sample to this one, the last inputs held."""
        count = len(self._derived)
        last = self._last
        n_inputs = len(values) - 1 - 2 * len(self._positions)
        if self._differenced:
            # Rates that are not recorded are held at the slope of the interval, known only now.
            rates = len(last) - len(self._rates)
            for j, r in enumerate(self._rates):
                if r is None:
                    last[rates + j] = self._slope[j]
            start = np.array(self._terms(last))
            if self._first is None:
                self._first = np.where(self._derived, start, 0.0)
            self._state[2, :count] = start - self._first
        before = [values[0], *last[1 : 1 + n_inputs], *values[1 + n_inputs :]]
        for k in self._ramps:
            before[1 + k] = values[1 + k]
        end = np.array(self._terms(before))
        assert self._first is not None
        self._state[3, :count] = end - self._first
        self._state[:2] = self._step @ self._state


def _reading(
    regression: Regression, variable: str, output_names: Sequence[str]
) -> tuple[int, float, float]:
    reading = regression.readings[variable]
    if reading.channel not in output_names:
        raise ChannelError(f"no channel '{reading.channel}'", remedy="measure it")
    return list(output_names).index(reading.channel), float(reading.offset), float(reading.gain)


def _scalar(symbols: Sequence[Sym], expressions: Sequence[Sym]) -> Callable[[Any], list[float]]:
    """Compile for one sample; `math` is ten times faster than numpy there."""
    known = [{"sign": _sign, "Heaviside": _heaviside}, "math"]
    return sp.lambdify([list(symbols)], list(expressions), known, cse=True)


def _sign(x: float) -> int:
    return (x > 0) - (x < 0)


def _heaviside(x: float, at_zero: float = 0.5) -> float:
    return at_zero if x == 0 else math.copysign(0.5, x) + 0.5


def _selection(
    parts: Sequence[tuple[Sym, Sym, Sym]],
    wanted: Sequence[tuple[int, Sym]],
    shape: tuple[int, int],
) -> Array:
    """Return (terms, rows · columns): which filtered terms make up which entry of the rows."""
    m, width = shape
    columns = width - NUISANCE - 1
    chosen = np.zeros((len(wanted) + NUISANCE, m, width))
    for number, part in enumerate(parts):
        column, row = divmod(number, m)
        place = NUISANCE + min(column, columns)
        for k, phi in enumerate(part):
            if phi != 0:
                chosen[wanted.index((2 - k, phi)), row, place] += 1.0
    for j in range(NUISANCE):
        chosen[len(wanted) + j, :, j] = 1.0
    return chosen.reshape(len(wanted) + NUISANCE, m * width)
