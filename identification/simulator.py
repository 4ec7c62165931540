"""What the comparison and the fit ask of a model: simulate one window."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from identification.problem import Matrix, Vector
from identification.shooting import Response


class Simulator(Protocol):
    """A model that can be run over windows of a record: `Shooting`, `FmuShooting`."""

    @property
    def nx(self) -> int:
        """Number of states whose initial value is open."""
        ...

    @property
    def sensitive(self) -> tuple[str, ...]:
        """Parameters that sensitivities are given for."""
        ...

    @property
    def state_names(self) -> tuple[str, ...]:
        """The states, in the order of the initial state."""
        ...

    @property
    def measured_states(self) -> Mapping[int, tuple[int, float]]:
        """State → (output, gain) where an output is this one state times a constant."""
        ...

    @property
    def rate_of(self) -> Mapping[str, str]:
        """State → the state that is its derivative, where that is known."""
        ...

    @property
    def begins_anywhere(self) -> bool:
        """Whether a window may begin within the record: its initial state can be set."""
        ...

    def parameter_vector(self, values: Mapping[str, float]) -> Vector:
        """Return the (np,) vector of all independent parameters."""
        ...

    def inputs_with_delays(self, inputs: Matrix, h: float, p: Vector) -> Matrix:
        """Return the (n, …) inputs as `run` takes them."""
        ...

    def run(
        self,
        x0: Vector,
        inputs: Matrix,
        p: Vector,
        h: float,
        *,
        t0: float = 0.0,
        sensitivities: bool = False,
    ) -> Response:
        """Simulate one window (see `Shooting.run`)."""
        ...
