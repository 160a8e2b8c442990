"""Norms of stable systems: the peak gain over frequency and the response to white noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.errors import AccuracyError
from residua.linear.norms.impulse_terms import doubled_sum, in_balanced_states
from residua.linear.subspaces.rank import spectral_norm
from residua.linear.systems.scaling import power_near
from residua.linear.systems.state_space import StateSpace

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PeakGain:
    """The largest gain of a system over all frequencies.

    Attributes
    ----------
    value : float
        The H-infinity norm.
    frequency : float
        Where it is reached, in rad/s; infinity when only the direct term reaches it.
    """

    value: float
    frequency: float


@dataclass(frozen=True, eq=False)
class _System:
    """A stable system in balanced states; ``theta`` is rad/s, or rad/sample in sampled time."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    dt: float

    @classmethod
    def of(cls, A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike | None, dt: float) -> _System:
        """Return a system whose inputs drive the states by as much as the outputs read of them."""
        s = in_balanced_states(StateSpace(A, B, C, D, dt=dt), "the norm")
        size_B, size_C = float(np.linalg.norm(s.B)), float(np.linalg.norm(s.C))
        even = float(power_near(np.sqrt(size_B / size_C))) if size_B and size_C else 1.0
        return cls(s.A, s.B / even, s.C * even, s.D, arrays.sample_step(dt))

    def gain(self, theta: float) -> float:
        """Return the largest singular value of the frequency response."""
        if np.isinf(theta):
            return spectral_norm(self.D)
        point = np.exp(1j * theta) if self.dt else 1j * theta
        X = np.linalg.solve(point * np.eye(self.A.shape[0]) - self.A, self.B)
        return spectral_norm(self.C @ X + self.D)

    def crossings(self, level: float) -> NDArray[np.float64]:
        """Return frequencies that include every one at which a singular value equals ``level``."""
        A, B, C, D = self.A, self.B, self.C, self.D
        n, m, p = A.shape[0], B.shape[1], C.shape[0]
        # States x, adjoint states q, input u, output w scaled by the level; no block is inverted.
        left = np.zeros((2 * n + m + p, 2 * n + m + p))
        x, q, u, w = np.split(np.arange(len(left)), np.cumsum([n, n, m]))
        right = np.zeros_like(left)
        left[np.ix_(x, x)], left[np.ix_(x, u)], right[x, x] = A, B, 1.0
        back, ahead = (right, left) if self.dt else (left, right)
        sign = 1.0 if self.dt else -1.0
        back[np.ix_(q, q)], back[np.ix_(q, w)], ahead[q, q] = sign * A.T, sign * C.T, 1.0
        rows = np.concatenate([w, u])  # y less the level times w, and what the adjoint reads less that times u
        left[np.ix_(rows, rows)] = np.block([[-level * np.eye(p), D], [D.T, -level * np.eye(m)]])
        left[np.ix_(w, x)], left[np.ix_(u, q)] = C, B.T
        values = scipy.linalg.eigvals(left, right)
        values = values[np.isfinite(values)]
        if self.dt:
            values = values[np.abs(values) > 1e-3]
            near = np.abs(np.log(np.abs(values))) < 1e-5
            return np.unique(np.abs(np.angle(values[near])))
        # Generous: an extra frequency costs one evaluation, a missed one the answer.
        size = np.maximum(np.abs(values), 1e-8 * np.abs(values).max(initial=0.0))
        near = np.abs(values.real) < 1e-5 * size
        return np.unique(np.abs(values.imag[near]))


def hinf_norm(
    A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike | None = None, dt: float = 0, *, rtol: float = 1e-6
) -> PeakGain:
    r"""Find the largest singular value of the frequency response.

    .. math:: \|G\|_\infty = \sup_\omega \sigma_{max}(G(j\omega))

    The value is attained at the returned frequency; the supremum exceeds it by no more than ``2 rtol``, relatively.

    Assumes
        Every pole is stable.

    Parameters
    ----------
    A : array_like, shape (n, n)
    B : array_like, shape (n, m)
    C : array_like, shape (p, n)
    D : array_like, shape (p, m), optional
    dt : float
        0 for continuous time, otherwise the sample step in seconds.
    rtol : float
        Relative accuracy.

    Returns
    -------
    PeakGain

    Raises
    ------
    ModelError
        If a matrix is malformed or a pole is not stable.
    AccuracyError
        If the iteration does not settle.

    References
    ----------
    Bruinsma and Steinbuch, A fast algorithm to compute the H-infinity norm, Systems & Control Letters 14 (1990)
    287-293.

    Examples
    --------
    >>> peak = hinf_norm([[0, 1], [-1, -0.2]], [[0], [1]], [[1, 0]])
    >>> round(peak.value, 4), round(peak.frequency, 3)
    (5.0252, 0.99)
    """
    system = _System.of(A, B, C, D, dt)
    if not system.A.size or not system.B.size or not system.C.size:
        return PeakGain(spectral_norm(system.D), 0.0)
    # the peak is likely at the resonances, at both ends and in between
    poles = np.linalg.eigvals(system.A)
    if system.dt:
        first = [0.0, *np.abs(np.angle(poles[np.abs(poles) > 1e-8])), *np.linspace(0.1, np.pi, 16)]
    else:
        sizes = np.abs(poles)
        first = [0.0, np.inf, *np.abs(poles.imag), *sizes, *np.geomspace(sizes.min() / 3, sizes.max() * 3, 16)]
    best, where = max((system.gain(theta), -theta) for theta in first)
    if best <= np.finfo(float).tiny:
        # At so many points only a zero transfer matrix is zero; its pencil would be singular.
        return PeakGain(best, 0.0)
    # Unit gain at the best point so far keeps the two halves of the pencil alike.
    root = np.sqrt(best)
    unit = _System(system.A, system.B / root, system.C / root, system.D / best, system.dt)
    level, where = 1.0, -where
    for _ in range(60):
        target = level * (1 + rtol)
        points = unit.crossings(target)
        tries = np.concatenate([points, (points[1:] + points[:-1]) / 2, np.sqrt(points[1:] * points[:-1])])
        gains = [unit.gain(theta) for theta in tries]
        if gains and max(gains) >= target:
            level, where = max(gains), float(tries[int(np.argmax(gains))])
            continue
        if where and np.isfinite(where):  # to the top of the peak, in a bracket of a thousandth
            from scipy.optimize import minimize_scalar  # slow to import

            high = where * (1 + 1e-3)
            bounds = where * (1 - 1e-3), min(high, np.pi) if system.dt else high
            options = {"xatol": 1e-8 * where}
            top = minimize_scalar(lambda theta: -unit.gain(theta), bounds=bounds, method="bounded", options=options)
            level, where = max((level, where), (-float(top.fun), float(top.x)))
        return PeakGain(level * best, float(where / (system.dt or 1.0)))
    raise AccuracyError(f"the peak gain did not settle in 60 iterations: {level * best:.9g} so far; use a larger rtol")


def h2_norm(A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike | None = None, dt: float = 0) -> float:
    r"""Return the root-mean-square output for white noise of unit intensity on every input.

    .. math:: \|G\|_2^2 = \mathrm{tr}(C X C^T + D D^T), \quad A X + X A^T + B B^T = 0

    in continuous time, where it is infinite unless ``D`` is zero; :math:`X = A X A^T + B B^T` in sampled time, for
    unit covariance per sample.

    Assumes
        Every pole is stable.

    Parameters
    ----------
    A, B, C, D : array_like
        See `hinf_norm`.
    dt : float
        0 for continuous time, otherwise the sample step in seconds.

    Returns
    -------
    float

    Raises
    ------
    ModelError
        If a matrix is malformed or a pole is not stable.
    AccuracyError
        If the Lyapunov equation is not solved.

    Examples
    --------
    >>> round(h2_norm([[-2.0]], [[2.0]], [[1.0]]), 9)
    1.0
    """
    system = _System.of(A, B, C, D, dt)
    if not system.dt and np.any(system.D):
        return float("inf")
    direct = float(np.sum(system.D**2))
    if not system.A.size or not system.B.size or not system.C.size:
        return float(np.sqrt(direct))
    A_, W = system.A, system.B @ system.B.T
    X = doubled_sum(A_, W) if system.dt else scipy.linalg.solve_continuous_lyapunov(A_, -W)
    if X is not None:
        rest = A_ @ X @ A_.T - X + W if system.dt else A_ @ X + X @ A_.T + W
        size = np.linalg.norm(X) * (1 + np.linalg.norm(A_)) ** 2 + np.linalg.norm(W)
    if X is None or not np.linalg.norm(rest) <= 1e-10 * size:
        raise AccuracyError(
            "the Lyapunov equation of the norm was not solved; a pole is too near to the stability boundary"
        )
    return float(np.sqrt(max(np.sum((system.C @ X) * system.C) + direct, 0.0)))
