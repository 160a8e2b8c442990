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
_ROUNDING = 1e-9
#: Terms are at least this part of the largest of their input: where nothing has to cancel, rounding is all there is.
_FLOOR = 1e-7


@dataclass(frozen=True, eq=False)
class Leak:
    """The leaks of a filter.

    Attributes
    ----------
    gains : ndarray, shape (residuals, inputs)
        Peak of the response over frequency, over the peak of the sum of the sizes of its terms: 1e-16 is exact, 1 is
        no decoupling. No number has a unit.
    defects : float
        The largest entry of the defects of the states, in balanced units: how far the identities are missed.
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
    units, n_u = plant.balanced.units, len(plant.inputs)
    R, X, Y = units.equations, units.states, units.outputs
    Bd, Dd = (plant.Bd, plant.Dd) if unknown is None else unknown
    B, D = np.hstack([plant.B, Bd]), np.hstack([plant.D, Dd])
    size = np.maximum(
        np.abs(R[:, None] * B).max(axis=0, initial=0.0) / units.rate, np.abs(Y[:, None] * D).max(axis=0, initial=0.0)
    )
    U = 1 / _power(size)
    A, B, C, D = (
        R[:, None] * plant.A * X / units.rate,
        R[:, None] * B * U / units.rate,
        Y[:, None] * plant.C * X,
        Y[:, None] * D * U,
    )
    E = np.eye(len(A)) if plant.E is None else R[:, None] * plant.E * X
    T = state_map / R
    driven = np.abs(np.hstack([T, system.B[:, n_u:] / Y / units.rate]))  # of T alone rounding may be all there is
    own = 1 / _power(driven.max(axis=1, initial=0.0))
    T = own[:, None] * T
    F = own[:, None] * system.A / own / units.rate
    Gy = own[:, None] * system.B[:, n_u:] / Y / units.rate
    Gu = own[:, None] * system.B[:, :n_u] * U[:n_u] / units.rate
    L, Jy, Ju = system.C / own, system.D[:, n_u:] / Y, system.D[:, :n_u] * U[:n_u]
    V = np.zeros((len(L), len(A))) if static_map is None else static_map / R * units.rate
    rows = np.hstack([L, Jy, Ju]) if estimate is None else estimate * X
    height = 1 / _power(np.abs(rows).max(axis=1, initial=0.0))[:, None]
    L, Jy, Ju, V = height * L, height * Jy, height * Ju, height * V
    wide = B.shape[1] - n_u
    Gu, Ju = (np.hstack([M, np.zeros((len(M), wide))]) for M in (Gu, Ju))
    dA = _sum((F, T, E), (Gy, C), (-T, A))
    dB = _sum((Gu,), (Gy, D), (-T, B))
    dC = _sum((L, T, E), (Jy, C), (V, A), *(() if estimate is None else ((-height * estimate * X,),)))
    dD = _sum((Ju,), (Jy, D), (V, B))
    s = _points(np.linalg.eigvals(F) if len(F) else np.zeros(0), _poles(A, plant, E), plant.is_discrete)
    states = _resolvent(A, E if plant.E is not None else None, B, s)
    through = _resolvent(F, None, np.hstack([Gy]), s, dA @ states + dB)
    response = np.abs(L @ through[1] + dC @ states + dD)
    if estimate is None:
        read = np.abs(C @ states + D)
        read = np.maximum(read, _ROUNDING * (np.abs(C) @ np.abs(states) + np.abs(D)))
        taken = np.abs(L @ through[0] + Jy)
        terms = (np.abs(Ju) + taken @ read).max(axis=0, initial=0.0)
        largest = taken.max(axis=(0, 2), initial=0.0)[:, None] * read.max(axis=(0, 1), initial=0.0)
    else:
        terms = np.abs((height * estimate * X) @ states).max(axis=0, initial=0.0)
        largest = np.full_like(terms, max(1.0, float(terms.max(initial=0.0))))
    terms = np.maximum(terms, _FLOOR * np.maximum(largest, terms.max(axis=0, keepdims=True, initial=0.0)))
    peak = response.max(axis=0, initial=0.0)
    gains = peak / np.where(terms > 0, terms, np.where(peak > 0, peak, 1.0))
    defects = max((float(np.abs(M).max(initial=0.0)) for M in (dA, dC)), default=0.0)
    slowest = np.angle(s[0]) / plant.dt if plant.is_discrete else s[0].imag * units.rate
    return Leak(gains, defects, float(slowest))


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
    Y = units.outputs
    size = np.abs(system.B[:, n_u:] / Y).max(axis=1, initial=0.0)
    own = 1 / _power(size)
    F = own[:, None] * system.A / own / units.rate
    G, L = own[:, None] * system.B[:, n_u:] / Y / units.rate, system.C / own
    w = np.geomspace(1e-3, 3.0, 7) if plant.is_discrete else np.geomspace(1e-3, 1e2, 7)
    states = _resolvent(F, None, G, np.exp(1j * w) if plant.is_discrete else 1j * w)
    response = np.abs(L @ states + system.D[:, n_u:] / Y)
    made_of = np.abs(L) @ np.abs(states) + terms / Y
    return np.any(response > _ROUNDING * made_of.max(axis=2, keepdims=True, initial=0.0), axis=(0, 2))


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


def _poles(A: Matrix, plant: Plant, E: Matrix) -> NDArray[np.complex128]:
    """Return the finite poles of a balanced plant."""
    if plant.E is None:
        return np.asarray(np.linalg.eigvals(A) if len(A) else np.zeros(0), dtype=complex)
    poles = scipy.linalg.eigvals(A, E)
    return np.asarray(poles[np.isfinite(poles) & (np.abs(poles) < 1 / _ROUNDING)], dtype=complex)


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
    return np.asarray(np.exp(1j * w) if sampled else 1j * w)


def _rates(poles: NDArray, sampled: bool) -> NDArray[np.complex128]:
    """Return poles of a sampled system as rates per sample; those at zero have none."""
    poles = np.asarray(poles, dtype=complex)
    return np.log(poles[np.abs(poles) > _ROUNDING]) if sampled else poles


def _resolvent(
    A: Matrix, E: Matrix | None, B: Matrix, s: NDArray[np.complex128], more: NDArray | None = None
) -> NDArray[np.complex128]:
    """Return ``(s E - A)^-1 B`` at points, shape (points, n, inputs); with ``more``, of it too, in front a pair."""
    n, wide = len(A), B.shape[1]
    right = (
        np.broadcast_to(B, (len(s), *B.shape))
        if more is None
        else np.concatenate([np.broadcast_to(B, (len(s), *B.shape)), more], axis=2)
    )
    if not n:
        out = np.zeros((len(s), 0, right.shape[2]), dtype=complex)
    else:
        if E is None:
            upper, Z = scipy.linalg.schur(A, output="complex")
            Q, lower = Z, np.eye(n)
        else:
            upper, lower, Q, Z = scipy.linalg.qz(A, E, output="complex")
        right = Q.conj().T @ right
        out = np.zeros_like(right, dtype=complex)
        for i in range(n - 1, -1, -1):
            row = s[:, None] * lower[i, i + 1 :] - upper[i, i + 1 :]
            rest = right[:, i] - np.einsum("kj,kjm->km", row, out[:, i + 1 :])
            pivot = s * lower[i, i] - upper[i, i]
            out[:, i] = rest / np.where(pivot == 0, np.finfo(float).eps, pivot)[:, None]
        out = Z @ out
    return out if more is None else (out[:, :, :wide], out[:, :, wide:])  # pyright: ignore[reportReturnType]


__all__ = ["LEAK", "Leak", "leak"]
