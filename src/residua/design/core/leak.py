r"""How far known inputs reach a residual or an estimate that should not answer to them.

With the state :math:`\xi = T E x + e` of a filter, what does not cancel is known algebraically: the *defects*

.. math::

   \Delta_A = F T E + G_y C - T A, \quad \Delta_B = G_u + G_y D - T B, \quad
   \Delta_C = L T E + J_y C + V A, \quad \Delta_D = J_u + J_y D + V B

of a filter :math:`\dot\xi = F \xi + G_u u + G_y y, \; r = L \xi + J_u u + J_y y`. The response of the residual is
:math:`L (s - F)^{-1} (\Delta_A X + \Delta_B) + \Delta_C X + \Delta_D` with :math:`X = (s E - A)^{-1} B`: no difference
of large numbers at any frequency. The defects are computed in extended precision, the rest in double.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.linear import StateSpace
from residua.plant import Plant
from residua.tolerances import LEAK

Matrix = NDArray[np.float64]
#: Frequencies between the slowest and the fastest rate, besides those next to each pole.
_POINTS = 60
#: How far below the slowest and above the fastest rate they go.
_BEYOND = 30.0
#: Rates of a plant, in units of its own, below which a pole is that of an integrator.
_INTEGRATES = 1e-5
#: A term this far below what it is made of, or below the largest of its input, is rounding.
_NO_TERM = 1e-9
#: Terms are at least this part of the largest of their input: where nothing has to cancel, rounding is all there is.
_LEAST_TERM = 1e-7
#: Complex numbers in the largest arrays: 64 MB.
_AT_ONCE = 4_000_000


@dataclass(frozen=True, eq=False)
class Leak:
    """The leaks of a filter.

    Attributes
    ----------
    gains : ndarray, shape (residuals, inputs)
        Peak of the response over frequency, over the peak of the sum of the sizes of its terms: 1e-16 is exact, 1 is
        no decoupling. No number has a unit.
    defects : float
        The largest entry of the defects of what is read, in balanced units: how far the identities are missed.
    slowest : float
        The lowest frequency, in rad/s.
    """

    gains: Matrix
    defects: float
    slowest: float


def leak(
    system: StateSpace,
    plant: Plant,
    state_map: Matrix,
    static_map: Matrix | None = None,
    *,
    unknown: tuple[Matrix, Matrix] | None = None,
    estimate: Matrix | None = None,
) -> Leak:
    """Return how far the controls and other inputs of a plant reach the outputs of a filter.

    Parameters
    ----------
    system : StateSpace
        From controls and outputs of the plant to residuals or estimates.
    plant : Plant
    state_map : ndarray, shape (states of the filter, n)
        ``T``.
    static_map : ndarray, shape (outputs of the filter, n), optional
        ``V``, with ``V E = 0``.
    unknown : tuple of ndarray, optional
        ``B`` and ``D`` of further inputs, which must not be seen; the disturbances when omitted.
    estimate : ndarray, shape (outputs of the filter, n), optional
        What the outputs estimate, ``M x``: the error is looked at, relative to the peak of what is estimated.
    """
    p = _balanced_plant(plant, (plant.Bd, plant.Dd) if unknown is None else unknown)
    f = _balanced_filter(system, plant, p, state_map, static_map, estimate)
    dA = _sum((f.F, f.T, p.E), (f.Gy, p.C), (-f.T, p.A))
    dB = _sum((f.Gu,), (f.Gy, p.D), (-f.T, p.B))
    dC = _sum((f.L, f.T, p.E), (f.Jy, p.C), (f.V, p.A), *(() if estimate is None else ((-f.estimate,),)))
    dD = _sum((f.Ju,), (f.Jy, p.D), (f.V, p.B))
    of_plant, of_filter = _Resolvent.of(p.A, None if plant.E is None else p.E), _Resolvent.of(f.F, None)
    s = _points(of_filter.poles, of_plant.poles, plant.is_discrete)
    shape = (len(f.L), p.B.shape[1])
    peak, terms, taken, read = np.zeros(shape), np.zeros(shape), np.zeros(len(f.L)), np.zeros(shape[1])
    for some in np.array_split(s, 1 + len(s) * max(len(p.A), len(f.F)) * (shape[1] + f.Gy.shape[1]) // _AT_ONCE):
        x = of_plant(p.B, some)
        missed = of_filter(dA @ x + dB, some)
        peak = np.maximum(peak, np.abs(f.L @ missed + dC @ x + dD).max(axis=0, initial=0.0))
        if estimate is not None:
            terms = np.maximum(terms, np.abs(f.estimate @ x).max(axis=0, initial=0.0))
            continue
        Q = np.abs(f.L @ of_filter(f.Gy, some) + f.Jy)
        P = np.maximum(np.abs(p.C @ x + p.D), _NO_TERM * (np.abs(p.C) @ np.abs(x) + np.abs(p.D)))
        terms = np.maximum(terms, (np.abs(f.Ju) + Q @ P).max(axis=0, initial=0.0))
        taken = np.maximum(taken, Q.max(axis=(0, 2), initial=0.0))
        read = np.maximum(read, P.max(axis=(0, 1), initial=0.0))
    largest = np.outer(taken, read) if estimate is None else np.full(shape, max(1.0, terms.max(initial=0.0)))
    terms = np.maximum(terms, _LEAST_TERM * np.maximum(largest, terms.max(axis=0, keepdims=True, initial=0.0)))
    gains = peak / np.where(terms > 0, terms, np.where(peak > 0, peak, 1.0))
    # a row of which rounding is all there is was scaled up to one: it counts by how far others read it
    used = np.minimum(np.abs(np.vstack([f.L, f.F - np.diag(np.diag(f.F))])).max(axis=0, initial=0.0), 1.0)
    defects = max((float(np.abs(M).max(initial=0.0)) for M in (used[:, None] * dA, dC)), default=0.0)
    slowest = np.angle(s[0]) / plant.dt if plant.is_discrete else s[0].imag * plant.balanced.units.rate
    return Leak(gains, defects, float(slowest))


@dataclass(frozen=True, eq=False)
class _Plant:
    """A balanced plant with controls and what else must not be seen as inputs of unit size, by factors ``inputs``."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    E: Matrix
    inputs: Matrix


@dataclass(frozen=True, eq=False)
class _Filter:
    """A filter of the balanced plant, its states and outputs of unit size, with its maps; see the module."""

    F: Matrix
    Gu: Matrix
    Gy: Matrix
    L: Matrix
    Ju: Matrix
    Jy: Matrix
    T: Matrix
    V: Matrix
    estimate: Matrix


def _balanced_plant(plant: Plant, unknown: tuple[Matrix, Matrix]) -> _Plant:
    units = plant.balanced.units
    R, X, Y = units.equations[:, None], units.states, units.outputs[:, None]
    B, D = R * np.hstack([plant.B, unknown[0]]) / units.rate, Y * np.hstack([plant.D, unknown[1]])
    U = 1 / _power(np.maximum(np.abs(B).max(axis=0, initial=0.0), np.abs(D).max(axis=0, initial=0.0)))
    E = np.eye(len(R)) if plant.E is None else R * plant.E * X
    return _Plant(R * plant.A * X / units.rate, B * U, Y * plant.C * X, D * U, E, U)


def _balanced_filter(
    system: StateSpace, plant: Plant, p: _Plant, T: Matrix, V: Matrix | None, estimate: Matrix | None
) -> _Filter:
    units, n_u = plant.balanced.units, len(plant.inputs)
    R, X, Y, U = units.equations, units.states, units.outputs, p.inputs[:n_u]
    T, Gy = T / R, system.B[:, n_u:] / Y / units.rate
    own = 1 / _power(np.abs(np.hstack([T, Gy])).max(axis=1, initial=0.0))[:, None]  # T alone may be rounding
    L, Jy, Ju = system.C / own[:, 0], system.D[:, n_u:] / Y, system.D[:, :n_u] * U
    M = np.zeros((len(L), len(R))) if estimate is None else estimate * X
    heights = np.hstack([L, Jy, Ju]) if estimate is None else M
    height = 1 / _power(np.abs(heights).max(axis=1, initial=0.0))[:, None]
    none = np.zeros((len(own), p.B.shape[1] - n_u)), np.zeros((len(L), p.B.shape[1] - n_u))
    return _Filter(
        own * system.A / own[:, 0] / units.rate,
        np.hstack([own * system.B[:, :n_u] * U / units.rate, none[0]]),
        own * Gy,
        height * L,
        np.hstack([height * Ju, none[1]]),
        height * Jy,
        own * T,
        np.zeros((len(L), len(R))) if V is None else height * V / R * units.rate,
        height * M,
    )


def answers(system: StateSpace, plant: Plant, terms: Matrix) -> NDArray[np.bool_]:
    """Tell which residuals answer to the measurements by more than rounding, at some frequency.

    Parameters
    ----------
    system : StateSpace
        From controls and outputs of the plant to residuals.
    plant : Plant
    terms : ndarray, shape (residuals, outputs)
        The sizes of what the direct responses to the outputs are made of.
    """
    units, n_u = plant.balanced.units, len(plant.inputs)
    G = system.B[:, n_u:] / units.outputs / units.rate
    own = 1 / _power(np.abs(G).max(axis=1, initial=0.0))[:, None]
    L = system.C / own[:, 0]
    w = np.geomspace(1e-3, 3.0, 7) if plant.is_discrete else np.geomspace(1e-3, 1e2, 7)
    resolvent = _Resolvent.of(own * system.A / own[:, 0] / units.rate, None)
    states = resolvent(own * G, np.asarray(np.exp(1j * w) if plant.is_discrete else 1j * w, dtype=complex))
    response = np.abs(L @ states + system.D[:, n_u:] / units.outputs)
    made_of = np.abs(L) @ np.abs(states) + terms / units.outputs
    return np.any(response > _NO_TERM * made_of.max(axis=2, keepdims=True, initial=0.0), axis=(0, 2))


def _power(size: Matrix) -> Matrix:
    """Return powers of two near sizes; 1 for zero."""
    return np.exp2(np.round(np.log2(np.where(size > 0, size, 1.0))))


def _sum(*products: tuple[Matrix, ...]) -> Matrix:
    """Return a sum of products, computed with extended precision."""
    total = np.longdouble(0.0)
    for first, *others in products:
        one = first.astype(np.longdouble)
        for other in others:
            one = one @ other.astype(np.longdouble)
        total = total + one
    return np.asarray(total, dtype=np.float64)


def _points(of_filter: NDArray, of_plant: NDArray, sampled: bool) -> NDArray[np.complex128]:
    """Return points on the boundary of stability, from far below the slowest rate to far above the fastest."""
    rates = [np.abs(_rates(poles, sampled)) for poles in (of_plant, of_filter)]
    rates[0] = rates[0][rates[0] > _INTEGRATES]
    every = np.concatenate([*rates, [] if sum(map(len, rates)) else [1.0]])
    every = every[np.isfinite(every) & (every > 0)]
    if not len(every):
        every = np.ones(1)
    ends = every.min() / _BEYOND, every.max() * _BEYOND
    if sampled:
        ends = min(ends[0], 1e-2), np.pi
    w = np.unique(np.concatenate([np.geomspace(*ends, _POINTS), 1.001 * every]))
    w = w[w <= np.pi] if sampled else w
    return np.asarray(np.exp(1j * w) if sampled else 1j * w, dtype=complex)


def _rates(poles: NDArray, sampled: bool) -> NDArray[np.complex128]:
    """Return poles of a sampled system as rates per sample; those at zero have none."""
    poles = np.asarray(poles, dtype=complex)
    return np.asarray(np.log(poles[np.abs(poles) > _NO_TERM]), dtype=complex) if sampled else poles


@dataclass(frozen=True, eq=False)
class _Resolvent:
    """``(s E - A)^-1``, from a Schur form: ``A = Q upper Z'``, ``E = Q lower Z'``."""

    upper: NDArray[np.complex128]
    lower: NDArray[np.complex128]
    Q: NDArray[np.complex128]
    Z: NDArray[np.complex128]

    @classmethod
    def of(cls, A: Matrix, E: Matrix | None) -> _Resolvent:
        """Return that of a matrix or a pencil."""
        if not len(A):
            none = np.zeros((0, 0), dtype=complex)
            return cls(none, none, none, none)
        if E is None:
            upper, Z = scipy.linalg.schur(A, output="complex")
            return cls(upper, np.eye(len(A), dtype=complex), Z, Z)
        return cls(*scipy.linalg.qz(A, E, output="complex"))

    @property
    def poles(self) -> NDArray[np.complex128]:
        """The finite eigenvalues."""
        a, b = np.diag(self.upper), np.diag(self.lower)
        finite = np.abs(b) > _NO_TERM * np.abs(a)
        return a[finite] / b[finite]

    def __call__(self, B: NDArray, s: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return ``(s E - A)^-1 B`` at points, shape (points, n, inputs); ``B`` may be one for each point."""
        right = self.Q.conj().T @ np.broadcast_to(B, (len(s), *B.shape[-2:]))
        out = np.zeros(right.shape, dtype=complex)
        for i in range(len(self.upper) - 1, -1, -1):
            row = s[:, None] * self.lower[i, i + 1 :] - self.upper[i, i + 1 :]
            pivot = s * self.lower[i, i] - self.upper[i, i]
            rest = right[:, i] - (row[:, None] @ out[:, i + 1 :])[:, 0]
            out[:, i] = rest / np.where(pivot == 0, np.finfo(float).eps, pivot)[:, None]
        return self.Z @ out


__all__ = ["LEAK", "Leak", "leak"]
