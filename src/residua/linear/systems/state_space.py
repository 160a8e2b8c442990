"""Linear state-space systems as values."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.arrays import frozen
from residua.errors import ModelError
from residua.linear.poles.zero_structure import explicit_poles
from residua.linear.systems.descriptor import finite_poles
from residua.linear.systems.scaling import scaling
from residua.tolerances import BALANCED_STABLE


@dataclass(frozen=True, init=False, eq=False)
class StateSpace:
    r"""A linear time-invariant system with named channels.

    .. math:: E \dot x = A x + B v, \qquad y = C x + D v

    in continuous time (``dt = 0``); in sampled time :math:`E x_{k+1}` stands on the left.

    Parameters
    ----------
    A : array_like, shape (n, n)
    B : array_like, shape (n, m)
    C : array_like, shape (p, n)
    D : array_like, shape (p, m), optional
        Zero when omitted.
    E : array_like, shape (n, n), optional
        Identity when omitted; may be singular (a descriptor system).
    dt : float
        0 for continuous time, otherwise the sample step in seconds.
    inputs, outputs, states : sequence of str, optional
        Channel names; ``v1..``, ``y1..``, ``x1..`` when omitted.

    Raises
    ------
    ModelError
        If a shape does not fit, an entry is not finite, or a name occurs twice.

    Examples
    --------
    >>> from residua.linear import StateSpace
    >>> lag = StateSpace([[-2.0]], [[1.0]], [[4.0]])
    >>> lag.poles()
    array([-2.+0.j])
    >>> float(lag.dc_gain()[0, 0])
    2.0
    """

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]
    E: NDArray[np.float64] | None
    dt: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    states: tuple[str, ...]

    def __init__(
        self,
        A: ArrayLike,
        B: ArrayLike,
        C: ArrayLike,
        D: ArrayLike | None = None,
        *,
        E: ArrayLike | None = None,
        dt: float = 0,
        inputs: Iterable[str] | None = None,
        outputs: Iterable[str] | None = None,
        states: Iterable[str] | None = None,
    ) -> None:
        A = square(A, "A")
        n = A.shape[0]
        B = arrays.matrix(B, "B", (n, None), what="one row per state")
        C = arrays.matrix(C, "C", (None, n), what="one column per state")
        m, p = B.shape[1], C.shape[0]
        D = frozen(np.zeros((p, m))) if D is None else arrays.matrix(D, "D", (p, m), what="outputs x inputs")
        if E is not None:
            E = arrays.matrix(E, "E", (n, n), what="one row per state")
            E = None if np.array_equal(E, np.eye(n)) else E
        self.__dict__.update(
            A=A,
            B=B,
            C=C,
            D=D,
            E=E,
            dt=arrays.sample_step(dt),
            inputs=arrays.names(inputs, m, "v", "inputs"),
            outputs=arrays.names(outputs, p, "y", "outputs"),
            states=arrays.names(states, n, "x", "states"),
        )

    # ------------------------------------------------------------------ facts

    @property
    def n_states(self) -> int:
        """Number of states."""
        return self.A.shape[0]

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return self.B.shape[1]

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return self.C.shape[0]

    @property
    def is_discrete(self) -> bool:
        """Flag of a system in sampled time."""
        return self.dt > 0

    @cached_property
    def _poles(self) -> NDArray[np.complex128]:
        if self.E is None:
            return explicit_poles(self.A)
        # Rank decisions reveal the poles at infinity: rounding throws those in chains far into the plane.
        return finite_poles(self.A, self.E)

    def poles(self) -> NDArray[np.complex128]:
        """Return the finite poles: those finite ``s`` with ``det(s E - A) = 0``; raises if every ``s`` has."""
        return self._poles.copy()

    def is_stable(self) -> bool:
        """Tell whether every finite pole lies inside the stability region, by more than rounding."""
        poles = self._poles
        if self.is_discrete:
            return bool((np.abs(poles) < 1 - BALANCED_STABLE).all())
        return bool((poles.real < -BALANCED_STABLE * np.abs(poles).max(initial=0.0)).all())

    def frequency_response(self, w: ArrayLike) -> NDArray[np.complex128]:
        """Evaluate the transfer matrix on the stability boundary.

        Parameters
        ----------
        w : array_like, shape (k,)
            Frequencies in rad/s; ``s = i w``, or ``z = exp(i w dt)`` for a sampled system.

        Returns
        -------
        ndarray, shape (k, p, m)

        Examples
        --------
        >>> from residua.linear import StateSpace
        >>> abs(StateSpace([[-1.0]], [[1.0]], [[1.0]]).frequency_response([1.0])[0, 0, 0]).round(6)
        np.float64(0.707107)
        """
        w = np.atleast_1d(np.asarray(w, dtype=float))
        points = np.exp(1j * w * self.dt) if self.is_discrete else 1j * w
        return self.evaluate(points)

    def evaluate(self, points: ArrayLike) -> NDArray[np.complex128]:
        """Evaluate ``C (s E - A)^-1 B + D`` at complex points; returns shape ``(k, p, m)``."""
        points = np.atleast_1d(np.asarray(points, dtype=complex))
        values = np.broadcast_to(self.D, (len(points), *self.D.shape)).astype(complex)
        if not self.n_states or not values.size:
            return values
        # elimination depends on the units of the states, and small responses would be lost in bad ones
        E: Any = np.eye(self.n_states)
        if self.E is None:
            A, T = scipy.linalg.matrix_balance(self.A)
            B, C = np.linalg.solve(T, self.B), self.C @ T
        else:
            units = scaling(self.A, self.B, self.C, self.D, self.E, sampled=self.is_discrete)
            R, X = units.equations[:, None], units.states
            A, B, C, E = R * self.A * X, R * self.B, self.C * X, R * self.E * X
        step = max(1, _AT_ONCE // self.n_states**2)
        for k in range(0, len(points), step):
            try:
                X = np.linalg.solve(points[k : k + step, None, None] * E - A, B)
            except np.linalg.LinAlgError as error:
                raise ModelError(f"the system has a pole at one of the points asked for: {error}") from error
            values[k : k + step] += C @ X
        return values

    def dc_gain(self) -> NDArray[np.float64]:
        """Return the gain for constant inputs; raises when the system integrates."""
        return np.asarray(self.evaluate(1.0 if self.is_discrete else 0.0)[0].real)

    # ----------------------------------------------------------- new systems

    def replaced(self, **changes: object) -> StateSpace:
        """Return a copy with some of the constructor's arguments changed."""
        if unknown := changes.keys() - set(_FIELDS):
            raise TypeError(f"a system has no {', '.join(sorted(unknown))}; known: {', '.join(_FIELDS)}")
        fields: dict[str, Any] = {name: self.__dict__[name] for name in _FIELDS} | changes
        new = StateSpace(**fields)
        if "_poles" in self.__dict__ and changes.keys().isdisjoint(("A", "E")):
            new.__dict__["_poles"] = self._poles
        return new

    def select(
        self, *, outputs: Iterable[str | int] | None = None, inputs: Iterable[str | int] | None = None
    ) -> StateSpace:
        """Return the system with only the named (or numbered) channels, in that order."""
        changes: dict[str, Any] = {}
        D = self.D
        if outputs is not None:
            rows = arrays.positions(outputs, self.outputs, "output")
            changes |= {"C": self.C.take(rows, axis=0), "outputs": tuple([self.outputs[i] for i in rows])}
            D = changes["D"] = D.take(rows, axis=0)
        if inputs is not None:
            columns = arrays.positions(inputs, self.inputs, "input")
            changes |= {"B": self.B.take(columns, axis=1), "inputs": tuple([self.inputs[i] for i in columns])}
            changes["D"] = D.take(columns, axis=1)
        return self.replaced(**changes)

    def series(self, other: StateSpace) -> StateSpace:
        """Return ``other`` after ``self``: the outputs of ``self`` drive the inputs of ``other`` in order."""
        dt = self._common_step(other)
        if self.n_outputs != other.n_inputs:
            raise ModelError(f"series: {self.n_outputs} outputs cannot drive {other.n_inputs} inputs")
        A = np.block([[self.A, np.zeros((self.n_states, other.n_states))], [other.B @ self.C, other.A]])
        return StateSpace(
            A,
            np.vstack([self.B, other.B @ self.D]),
            np.hstack([other.D @ self.C, other.C]),
            other.D @ self.D,
            E=_block_E(self, other),
            dt=dt,
            inputs=self.inputs,
            outputs=other.outputs,
            states=_joined(self.states, other.states),
        )

    def parallel(self, other: StateSpace) -> StateSpace:
        """Return the sum of the two transfer matrices; inputs and outputs are matched in order."""
        dt = self._common_step(other)
        if self.D.shape != other.D.shape:
            raise ModelError(f"parallel: {self.D.shape} and {other.D.shape} (outputs, inputs) do not match")
        return StateSpace(
            scipy.linalg.block_diag(self.A, other.A),
            np.vstack([self.B, other.B]),
            np.hstack([self.C, other.C]),
            self.D + other.D,
            E=_block_E(self, other),
            dt=dt,
            inputs=self.inputs,
            outputs=self.outputs,
            states=_joined(self.states, other.states),
        )

    def append(self, other: StateSpace) -> StateSpace:
        """Return both systems side by side, with all inputs and all outputs."""
        return StateSpace(
            scipy.linalg.block_diag(self.A, other.A),
            scipy.linalg.block_diag(self.B, other.B),
            scipy.linalg.block_diag(self.C, other.C),
            scipy.linalg.block_diag(self.D, other.D),
            E=_block_E(self, other),
            dt=self._common_step(other),
            inputs=_joined(self.inputs, other.inputs),
            outputs=_joined(self.outputs, other.outputs),
            states=_joined(self.states, other.states),
        )

    def explicit(self) -> StateSpace:
        """Return the system with ``E`` divided out; raises when ``E`` is singular or nearly so, in whatever units."""
        if self.E is None:
            return self
        units = scaling(self.A, self.B, self.C, self.D, self.E, sampled=self.is_discrete)
        rows, columns = units.equations[:, None], units.states
        E = rows * self.E * columns
        condition = np.linalg.cond(E) if self.n_states else 1.0
        if not condition < 1e12:
            raise ModelError(
                f"E is singular to working precision (condition {condition:.2g}): "
                "this step needs a plant without algebraic equations"
            )
        whole = columns[:, None] * np.linalg.solve(E, rows * np.hstack([self.A, self.B]))
        return self.replaced(A=whole[:, : self.n_states], B=whole[:, self.n_states :], E=None)

    def discretize(self, dt: float, *, hold: str | Iterable[str] = "zero") -> StateSpace:
        """Sample the system; see :func:`residua.linear.systems.sampling.sample` for what is exact."""
        from residua.linear.systems.sampling import sample

        return sample(self, dt, hold=hold)

    # ----------------------------------------------------------------- running

    def simulate(self, v: ArrayLike, x0: ArrayLike | None = None) -> NDArray[np.float64]:
        """Run the sampled system over an input sequence.

        Parameters
        ----------
        v : array_like, shape (time, m) or (plants, time, m)
        x0 : array_like, shape (n,), optional
            Initial state, zero when omitted.

        Returns
        -------
        ndarray, shape (time, p) or (plants, time, p)
        """
        from residua.linear.systems.recursion import run_filter

        if not self.is_discrete:
            raise ModelError("a continuous system has no samples to run over: discretize(dt) first")
        system = self.explicit()
        data = np.asarray(v, dtype=float)
        if data.ndim not in (2, 3) or data.shape[-1] != self.n_inputs:
            raise ModelError(f"v must be (time, {self.n_inputs}), got shape {data.shape}")
        block = data if data.ndim == 3 else data[None]
        start = np.zeros(self.n_states) if x0 is None else np.asarray(x0, dtype=float)
        if start.shape not in ((self.n_states,), (len(block), self.n_states)):
            raise ModelError(f"x0 must have {self.n_states} entries, got shape {start.shape}")
        state = np.broadcast_to(start, (len(block), self.n_states))
        _, y = run_filter(system.A, system.B, system.C, system.D, state, block)
        return y if data.ndim == 3 else y[0]

    def _common_step(self, other: StateSpace) -> float:
        if self.dt != other.dt:
            raise ModelError(f"cannot connect systems with dt={self.dt:g} and dt={other.dt:g}")
        return self.dt

    def __repr__(self) -> str:
        kind = f"dt={self.dt:g}" if self.is_discrete else "continuous"
        return (
            f"StateSpace({self.n_states} states, {self.n_inputs} inputs, {self.n_outputs} outputs, {kind}"
            f"{', descriptor' if self.E is not None else ''})"
        )


#: Complex numbers in the matrices that are solved with together.
_AT_ONCE = 4_000_000
_FIELDS = ("A", "B", "C", "D", "E", "dt", "inputs", "outputs", "states")


def stack_systems(systems: list[StateSpace]) -> StateSpace:
    """Return generators with the same inputs as one, their residuals one below the other."""
    first = systems[0]
    return StateSpace(
        scipy.linalg.block_diag(*(s.A for s in systems)),
        np.vstack([s.B for s in systems]),
        scipy.linalg.block_diag(*(s.C for s in systems)),
        np.vstack([s.D for s in systems]),
        dt=first.dt,
        inputs=first.inputs,
        outputs=[f"{name}, filter {k}" for k, s in enumerate(systems, 1) for name in s.outputs],
    )


def square(value: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return ``value`` as a read-only square matrix, also the empty one."""
    try:
        empty = np.size(value) == 0
    except ValueError:  # ragged: matrix() says so
        empty = False
    if empty:
        return frozen(np.zeros((0, 0)))
    M = arrays.matrix(value, name, (None, None))
    if M.shape[0] != M.shape[1]:
        raise ModelError(f"{name} must be square, got {M.shape[0]} x {M.shape[1]}")
    return M


def _block_E(first: StateSpace, second: StateSpace) -> NDArray | None:
    if first.E is None and second.E is None:
        return None
    parts = [np.eye(s.n_states) if s.E is None else s.E for s in (first, second)]
    return scipy.linalg.block_diag(*parts)


def _joined(first: tuple[str, ...], second: tuple[str, ...]) -> tuple[str, ...]:
    """Join two name tuples; names of the second that are taken get a number."""
    taken = set(first)
    out = list(first)
    for name in second:
        fresh, k = name, 2
        while fresh in taken:
            fresh, k = f"{name}_{k}", k + 1
        taken.add(fresh)
        out.append(fresh)
    return tuple(out)
