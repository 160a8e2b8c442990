"""A filter and its plant in balanced units: their responses where a design is checked, and the map of its states."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.linear import StateSpace
from residua.linear.subspaces.parts import Indices, connected_parts
from residua.linear.subspaces.quotient import observable_split
from residua.linear.systems.scaling import power_near
from residua.plant import Plant
from residua.tolerances import BALANCED_RANK

Matrix = NDArray[np.float64]
#: Frequencies between the slowest and the fastest rate, besides those next to each pole.
_POINTS = 60
#: How far below the slowest and above the fastest rate they go.
_BEYOND = 30.0
#: Rates of a plant, in units of its own, below which a pole is that of an integrator.
_INTEGRATES = 1e-5
#: A pole of a sampled system this near to zero has no rate; an infinite one of a pencil is as far from finite.
_NO_RATE = 1e-9
#: Where the states of a filter are compared: per sample, or in units of the rate of the plant.
_ANGLES = np.array([0.1, 0.7, 2.5])
#: Rows of triangular systems that are solved together.
_ROWS = 16


@dataclass(frozen=True, eq=False)
class BalancedFilter:
    r"""A filter :math:`\dot\xi = F \xi + G_u u + G_y y, \; r = L \xi + J_u u + J_y y` of a balanced plant.

    Its states and outputs are of unit size; all factors are powers of two.

    Attributes
    ----------
    plant : Plant
    A, C, E : ndarray
        Of the plant.
    F, Gu, Gy, L, Ju, Jy : ndarray
        Of the filter; columns of ``Gu`` and ``Ju`` in the plant's own units of its controls.
    T, V : ndarray
        The state and the static map of the filter.
    heights : ndarray, shape (outputs of the filter,)
        What its outputs are multiplied by.
    estimate : ndarray
        What the outputs estimate, ``M x``, in these units; zero where they estimate nothing.
    """

    plant: Plant
    A: Matrix
    C: Matrix
    E: Matrix
    F: Matrix
    Gu: Matrix
    Gy: Matrix
    L: Matrix
    Ju: Matrix
    Jy: Matrix
    T: Matrix
    V: Matrix
    heights: Matrix
    estimate: Matrix

    @classmethod
    def of(
        cls,
        system: StateSpace,
        plant: Plant,
        T: Matrix,
        V: Matrix | None = None,
        estimate: Matrix | None = None,
    ) -> BalancedFilter:
        """Return a filter with its maps in balanced units."""
        units, n_u = plant.balanced.units, len(plant.inputs)
        R, X, Y, rate = units.equations, units.states, units.outputs, units.rate
        T, Gy = T / R, system.B[:, n_u:] / Y / rate
        states = 1 / power_near(np.abs(np.hstack([T, Gy])).max(axis=1, initial=0.0))[:, None]  # T alone may be rounding
        L, Jy, Ju = system.C / states[:, 0], system.D[:, n_u:] / Y, system.D[:, :n_u]
        M = np.zeros((len(L), len(R))) if estimate is None else estimate * X
        whole = np.hstack([L, Jy, Ju * units.inputs[:n_u]]) if estimate is None else M
        height = 1 / power_near(np.abs(whole).max(axis=1, initial=0.0))[:, None]
        return cls(
            plant,
            *plant.balanced.written,
            states * system.A / states[:, 0] / rate,
            states * system.B[:, :n_u] / rate,
            states * Gy,
            height * L,
            height * Ju,
            height * Jy,
            states * T,
            np.zeros((len(L), len(R))) if V is None else height * V / R * rate,
            height[:, 0],
            height * M,
        )

    def entering(self, B: Matrix, D: Matrix) -> tuple[Matrix, Matrix, Matrix]:
        """Return ``B`` and ``D`` of some inputs of the plant in balanced units, of unit size, and their factors."""
        units = self.plant.balanced.units
        B, D = units.equations[:, None] * B / units.rate, units.outputs[:, None] * D
        U = 1 / power_near(np.maximum(np.abs(B).max(axis=0, initial=0.0), np.abs(D).max(axis=0, initial=0.0)))
        return B * U, D * U, U

    @cached_property
    def of_plant(self) -> Resolvent:
        """The resolvent of the plant."""
        return Resolvent.of(self.A, None if self.plant.E is None else self.E)

    @cached_property
    def of_filter(self) -> Resolvent:
        """The resolvent of the filter."""
        return Resolvent.of(self.F, None)

    @cached_property
    def points(self) -> NDArray[np.complex128]:
        """Points on the boundary of stability, from far below the slowest rate to far above the fastest."""
        sampled = self.plant.is_discrete
        plant, rates = (
            np.abs(np.log(poles[np.abs(poles) > _NO_RATE]) if sampled else poles)  # per sample, poles at zero have none
            for poles in (self.of_plant.poles, self.of_filter.poles)
        )
        # an integrator counts at the rate of the other terms of the plant, which is one
        every = np.concatenate([np.where(plant > _INTEGRATES, plant, 1.0), rates])
        every = every[np.isfinite(every) & (every > 0)]
        every = every if len(every) else np.ones(1)
        ends = every.min() / _BEYOND, np.pi if sampled else every.max() * _BEYOND
        w = np.unique(np.concatenate([np.geomspace(*ends, _POINTS), 1.001 * every]))
        w = w[w <= np.pi] if sampled else w
        return np.asarray(np.exp(1j * w) if sampled else 1j * w, dtype=complex)

    @property
    def slowest(self) -> float:
        """The lowest frequency, in rad/s."""
        s = self.points[0]
        return float(np.angle(s) / self.plant.dt if self.plant.is_discrete else s.imag * self.plant.balanced.units.rate)

    def read(self, points: NDArray[np.complex128]) -> Matrix:
        """Return the sizes of the responses of the filter to the outputs of the plant, shape (points, r, outputs)."""
        Q = np.tile(self.Jy.astype(complex), (len(points), 1, 1))
        for states, part in self.of_filter.parts:
            rows = np.any(self.L[:, states], axis=1)
            Q[:, rows] += self.L[np.ix_(rows, states)] @ part(self.Gy[states], points)
        return np.abs(Q)


@dataclass(frozen=True, eq=False)
class Resolvent:
    """``(s E - A)^-1``, in parts that nothing connects, such as filters side by side."""

    parts: list[tuple[Indices, SchurForm]]

    @classmethod
    def of(cls, A: Matrix, E: Matrix | None) -> Resolvent:
        """Return that of a matrix or a pencil."""
        if E is not None:
            return cls([(np.arange(len(A)), SchurForm(*scipy.linalg.qz(A, E, output="complex")))] if len(A) else [])
        return cls([(states, SchurForm.of(A[np.ix_(states, states)])) for states in connected_parts(A != 0)])

    @property
    def poles(self) -> NDArray[np.complex128]:
        """The finite eigenvalues."""
        return np.concatenate([np.zeros(0, dtype=complex), *(part.poles for _, part in self.parts)])

    def __call__(self, B: NDArray, s: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return ``(s E - A)^-1 B`` at points, shape (points, n, inputs); ``B`` may be one for each point."""
        if len(self.parts) == 1:
            return self.parts[0][1](B, s)
        x = np.zeros((len(s), *B.shape[-2:]), dtype=complex)
        for states, part in self.parts:
            x[:, states] = part(B[..., states, :], s)
        return x


@dataclass(frozen=True, eq=False)
class SchurForm:
    """A matrix or a pencil in one connected part: ``A = Q upper Z'``, ``E = Q lower Z'``."""

    upper: NDArray[np.complex128]
    lower: NDArray[np.complex128]
    Q: NDArray[np.complex128]
    Z: NDArray[np.complex128]

    @classmethod
    def of(cls, A: Matrix) -> SchurForm:
        """Return that of a matrix."""
        upper, Z = scipy.linalg.schur(A, output="complex")
        return cls(upper, np.eye(len(A), dtype=complex), Z, Z)

    @property
    def poles(self) -> NDArray[np.complex128]:
        """The finite eigenvalues."""
        a, b = np.diag(self.upper), np.diag(self.lower)
        finite = np.abs(b) > _NO_RATE * np.abs(a)
        return a[finite] / b[finite]

    def __call__(self, B: NDArray, s: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return ``(s E - A)^-1 B`` at points."""
        right = self.Q.conj().T @ B
        n, m = right.shape[-2:]
        x = np.array(np.broadcast_to(right, (len(s), n, m)).transpose(1, 0, 2), dtype=complex, order="C")
        ordinary = not np.any(np.triu(self.lower, 1))

        def subtract(rows: slice, below: slice) -> None:
            known = x[below].reshape(below.stop - below.start, len(s) * m)
            x[rows] += (self.upper[rows, below] @ known).reshape(x[rows].shape)
            if not ordinary:
                x[rows] -= s[:, None] * (self.lower[rows, below] @ known).reshape(x[rows].shape)

        for end in range(n, 0, -_ROWS):
            first = max(0, end - _ROWS)
            subtract(slice(first, end), slice(end, n))  # of all rows of a block at once
            for i in range(end - 1, first - 1, -1):
                subtract(slice(i, i + 1), slice(i + 1, end))
                pivot = s * self.lower[i, i] - self.upper[i, i]
                x[i] *= (1 / np.where(pivot == 0, np.finfo(float).eps, pivot))[:, None]
        return np.ascontiguousarray((self.Z @ x.reshape(n, len(s) * m)).reshape(n, len(s), m).transpose(1, 0, 2))


def extended_sum(*products: tuple[Matrix, ...]) -> Matrix:
    """Return a sum of products, computed with extended precision."""
    total = np.longdouble(0.0)
    for first, *others in products:
        one = first.astype(np.longdouble)
        for other in others:
            one = one @ other.astype(np.longdouble)
        total = total + one
    return np.asarray(total, dtype=np.float64)


def state_map_of(system: StateSpace, plant: Plant) -> tuple[StateSpace, Matrix, Matrix | None]:
    r"""Return a filter without the states that it does not show, and its states as a function of those of the plant.

    Of a filter :math:`\dot\xi = F \xi + G_u u + G_y y, \; r = L \xi + J_u u + J_y y`, ``L`` seeing all of ``F``, whose
    residual is zero whatever a controllable plant does, :math:`\xi = T E x` with the one ``T`` that solves

    .. math:: F T E + G_y C = T A, \qquad L T E + J_y C + V A = 0, \qquad V E = 0

    and then :math:`T B = G_u + G_y D` and :math:`J_u + J_y D + V B = 0`. Of another filter these are missed.

    Parameters
    ----------
    system : StateSpace
        From controls and outputs of the plant to residuals.
    plant : Plant

    Returns
    -------
    StateSpace
        The filter itself where it shows all of its states.
    ndarray, shape (states of that filter, n)
        ``T``, by least squares where nothing solves the equations.
    ndarray, shape (residuals, n), or None
        ``V``; none where ``E`` is invertible.
    """
    states, rows = _sizes(system, plant)
    A, C = system.A / states[:, None] * states, system.C * states
    split = observable_split(A / power_near(np.abs(A).max(initial=0.0)), rows * C)
    if split.hidden.shape[1]:
        O = split.seen  # noqa: E741
        system = system.replaced(A=O.T @ A @ O, B=O.T / states @ system.B, C=C @ O, states=None)
    T = state_map(system, plant)
    return system, T, static_map(system, plant, T)


def state_map(system: StateSpace, plant: Plant) -> Matrix:
    r"""Return the ``T`` of `state_map_of`; one of those that there are where the filter does not show all its states.

    A Schur form of the plant, its finite modes first, gives ``T`` column by column, whatever modes plant and filter
    share: of a mode :math:`\lambda`, :math:`[\lambda - F; L]` has full column rank where ``L`` sees all of ``F``.

    References
    ----------
    Golub, Nash and Van Loan (1979), IEEE TAC 24(6): the Sylvester equation by columns of a Schur form.
    """
    model, n_u, k = plant.balanced, len(plant.inputs), system.n_states
    (A, C, E), rate, Y = model.written, model.units.rate, model.units.outputs
    states, rows = _sizes(system, plant)
    F, L = system.A / states[:, None] * states / rate, rows * system.C * states
    n, finite = plant.n_states, len(model.dynamics)
    if plant.E is None:
        S, Z = scipy.linalg.schur(A, output="complex") if n else (A, A)
        P, Q = E, Z
    else:

        def finite_first(alpha: NDArray[np.complex128], beta: NDArray[np.complex128]) -> NDArray[np.bool_]:
            order = np.argsort(-np.abs(beta) / np.hypot(np.abs(alpha), np.abs(beta)))
            return np.isin(np.arange(n), order[:finite])

        S, P, _, _, Q, Z = scipy.linalg.ordqz(A, E, sort=finite_first, output="complex")
    G, J = system.B[:, n_u:] / states[:, None] / Y / rate @ C @ Z, rows * system.D[:, n_u:] / Y @ C @ Z
    X = np.zeros((k, n), dtype=complex)
    for j in range(n if k else 0):
        before = X[:, :j] @ P[:j, j]
        pencil, right = S[j, j] * np.eye(k) - P[j, j] * F, G[:, j] + F @ before - X[:, :j] @ S[:j, j]
        if j < finite:  # where V reads nothing
            pencil, right = np.vstack([pencil, P[j, j] * L]), np.concatenate([right, -J[:, j] - L @ before])
        X[:, j] = scipy.linalg.lstsq(pencil, right, lapack_driver="gelsy")[0]
    T = np.asarray((X @ Q.conj().T).real, dtype=np.float64)
    T[np.abs(T).max(axis=1, initial=0.0) < BALANCED_RANK] = 0.0  # states that signals move but the plant does not
    return states[:, None] * T * model.units.equations


def static_map(system: StateSpace, plant: Plant, T: Matrix) -> Matrix | None:
    """Return the ``V`` of `state_map_of`: the algebraic equations in the residuals, if the plant has any."""
    model, n_u = plant.balanced, len(plant.inputs)
    if not len(model.algebra):
        return None
    (A, C, E), units, rows = model.written, model.units, _sizes(system, plant)[1]
    missing = rows * system.C @ (T / units.equations) @ E + rows * system.D[:, n_u:] / units.outputs @ C
    read = np.linalg.lstsq((model.algebra @ A).T, missing.T, rcond=BALANCED_RANK)[0].T
    read[np.abs(read).max(axis=1, initial=0.0) < BALANCED_RANK] = 0.0  # a residual that reads none
    return -read @ model.algebra * units.equations / rows / units.rate


def _sizes(system: StateSpace, plant: Plant) -> tuple[Matrix, Matrix]:
    """Return the sizes of the states of a filter for balanced signals, and factors that make its outputs near one.

    Powers of two; one for states that no signal reaches.
    """
    units, k = plant.balanced.units, system.n_states
    signals = np.concatenate([units.inputs[: len(plant.inputs)], 1 / units.outputs])
    points = np.exp(1j * _ANGLES) if system.is_discrete else 1j * units.rate * _ANGLES
    responses = np.linalg.solve(points[:, None, None] * np.eye(k) - system.A, (system.B * signals).astype(complex))
    states = power_near(np.abs(responses).max(axis=(0, 2), initial=0.0))
    whole = np.abs(np.hstack([system.C * states, system.D * signals]))
    return states, 1 / power_near(whole.max(axis=1, initial=0.0))[:, None]
