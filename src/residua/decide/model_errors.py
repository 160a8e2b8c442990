"""Effects of model errors on the residual, as systems from the inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from residua.design import ResidualGenerator
from residua.errors import ModelError
from residua.linear import StateSpace
from residua.number_kinds import BOUND, NumberKind
from residua.plant import Plant
from residua.records import Record
from residua.tolerances import SAME
from residua.visible import echo

#: Up to so many parameters all corners of their box are looked at together; beyond, one parameter after the other.
_TOGETHER = 4
#: A response that settles more slowly than within so many samples is taken for one that does not.
_SLOWEST = 1e6


@runtime_checkable
class ParameterBox(Protocol):
    """Interface of an uncertain plant, such as :class:`residua.plant.UncertainPlant`."""

    @property
    def nominal(self) -> Plant:
        """The plant with the nominal parameters."""
        ...

    @property
    def low(self) -> NDArray[np.float64]:
        """Smallest values of the parameters."""
        ...

    @property
    def high(self) -> NDArray[np.float64]:
        """Largest values."""
        ...

    @property
    def nominal_values(self) -> NDArray[np.float64]:
        """Nominal values."""
        ...

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        ...

    def member(self, values: Any) -> Plant:
        """Return the plant with these parameters."""
        ...

    def vertex_values(self) -> NDArray[np.float64]:
        """Return the corners of the box, one in each row."""
        ...


@dataclass(frozen=True, eq=False)
class OutputError(Record):
    r"""Error of a model's outputs, :math:`\Delta y = \Delta G\, u`.

    Attributes
    ----------
    name : str
    A, B, C, D : ndarray
        From the inputs to the outputs, as deviations.
    dt : float
        0 of a continuous one.
    """

    NUMBER_KINDS: ClassVar[dict[str, NumberKind]] = {"dt": BOUND}

    name: str
    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]
    dt: float

    @property
    def system(self) -> StateSpace:
        """The error as a system."""
        return StateSpace(self.A, self.B, self.C, self.D, dt=self.dt)


def errors_of_parameters(uncertain: ParameterBox) -> tuple[tuple[OutputError, ...], bool]:
    """Return the errors of the outputs over a box of parameters, and a flag for errors that exclude each other.

    Up to four parameters: those of all corners of the box, of which one holds at a time. Of more: each parameter alone,
    at the end that is farther from its nominal value, and all of them at once.
    """
    names, middle = uncertain.names, np.asarray(uncertain.nominal_values, dtype=float)
    together = 0 < len(names) <= _TOGETHER
    if together:
        rows = np.asarray(uncertain.vertex_values(), dtype=float)
        labels = [", ".join(f"{n}={v:.4g}" for n, v in zip(names, row, strict=True)) for row in rows.tolist()]
    else:
        low, high = np.asarray(uncertain.low, dtype=float), np.asarray(uncertain.high, dtype=float)
        far = np.where(high - middle >= middle - low, high, low)
        rows = np.where(np.eye(len(names), dtype=bool), far, middle)
        labels = list(names)
    base = _from_inputs(uncertain.nominal)
    errors = []
    for label, row in zip(labels, rows, strict=True):
        if (row == middle).all():
            continue
        apart = _from_inputs(uncertain.member(row)).parallel(_times(base, -1.0))
        errors.append(OutputError(label, apart.A, apart.B, apart.C, apart.D, apart.dt))
    if not errors:
        raise ModelError("no parameter of this uncertain plant is uncertain: it has no member but the nominal one")
    return tuple(errors), together


def errors_of_gains(plant: Plant, *, changes: bool = False) -> tuple[OutputError, ...]:
    """Return for each output and input the error that doubles the response.

    With ``changes`` also where it comes a sample late: the difference of the response to that of the sample before.
    """
    whole = _from_inputs(plant)
    errors = []
    for i, output in enumerate(plant.outputs):
        for j, command in enumerate(plant.inputs):
            one = whole.select(outputs=[i], inputs=[j])
            if not ((one.B.any() and one.C.any()) or one.D.any()):
                continue
            into = np.zeros((1, len(plant.inputs)))
            into[0, j] = 1.0
            onto = np.zeros((len(plant.outputs), 1))
            onto[i, 0] = 1.0
            name = f"{output} by {command}"
            errors.append(OutputError(name, one.A, one.B @ into, onto @ one.C, onto @ one.D @ into, one.dt))
            if changes:
                late = _change(one)
                errors.append(
                    OutputError(f"{name}, late", late.A, late.B @ into, onto @ late.C, onto @ late.D @ into, late.dt)
                )
    return tuple(errors)


def residual_errors(errors: Sequence[OutputError], generator: ResidualGenerator) -> tuple[StateSpace, ...]:
    """Return for each error the system from the inputs to the residual.

    Raises
    ------
    ModelError
        If a response does not settle, or the errors are not those of this plant.
    """
    plant, dt = generator.plant, generator.dt
    m, p = len(plant.inputs), len(plant.outputs)
    filtered = generator.system.select(inputs=range(m, m + p))
    parts = []
    for one in errors:
        system = one.system
        if system.n_inputs != m or system.n_outputs != p:
            raise ModelError(
                f"the errors are those of a plant with {system.n_inputs} inputs and {system.n_outputs} outputs, this "
                f"one has {m} and {p}"
            )
        if not system.is_discrete:
            system = system.discretize(dt)
        elif abs(system.dt - dt) > SAME * dt:
            raise ModelError(f"the errors are those of a plant with dt={system.dt:g} s, the monitor runs at {dt:g} s")
        radius = float(np.abs(np.linalg.eigvals(system.A)).max(initial=0.0))
        if radius > 1 - 1 / _SLOWEST:
            raise ModelError(
                f"the model's response {echo(one.name)} does not settle (pole of size {radius:.6g}): what errors of it "
                "do follows from the inputs of a stable plant only; take NormThreshold, or a model of the closed loop"
            )
        parts.append(system.series(filtered))
    return tuple(parts)


def _from_inputs(plant: Plant) -> StateSpace:
    p = plant.explicit()
    return StateSpace(p.A, p.B, p.C, p.D, dt=p.dt)


def _times(system: StateSpace, factor: float) -> StateSpace:
    return StateSpace(system.A, system.B, factor * system.C, factor * system.D, dt=system.dt)


def _change(system: StateSpace) -> StateSpace:
    """Return a sampled system with its outputs differenced."""
    n, p = system.n_states, system.n_outputs
    A = np.block([[system.A, np.zeros((n, p))], [system.C, np.zeros((p, p))]])
    B = np.vstack([system.B, system.D])
    return StateSpace(A, B, np.hstack([system.C, -np.eye(p)]), system.D, dt=system.dt)
