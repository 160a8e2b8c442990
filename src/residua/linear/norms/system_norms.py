"""Norms of stable systems: the peak gain over frequency and the response to white noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.errors import AccuracyError, ModelError
from residua.linear.poles.spectrum import describe_modes
from residua.linear.poles.stability import is_stable_mode
from residua.linear.subspaces.rank import spectral_norm
from residua.linear.systems.scaling import power_near, scaling

Matrix = NDArray[np.float64]
_EPS = float(np.finfo(float).eps)


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
    """A checked, stable system in balanced states; ``theta`` is rad/s, or rad/sample in sampled time."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    dt: float
    poles: NDArray[np.complex128]

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
        zero = np.zeros
        left = np.block(
            [
                [A, zero((n, n)), B, zero((n, p))],
                [
                    zero((n, n)),
                    np.eye(n) if self.dt else -A.T,
                    zero((n, m)),
                    zero((n, p)) if self.dt else -C.T,
                ],
                [C, zero((p, n)), D, -level * np.eye(p)],
                [zero((m, n)), B.T, -level * np.eye(m), D.T],
            ]
        )
        right = zero(left.shape)
        right[:n, :n] = np.eye(n)
        right[n : 2 * n, n : 2 * n] = A.T if self.dt else np.eye(n)
        if self.dt:
            right[n : 2 * n, 2 * n + m :] = C.T
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


def _stable_system(A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike | None, dt: float) -> _System:
    dt = arrays.sample_step(dt)
    A = arrays.matrix(A, "A", (None, None))
    n = A.shape[0]
    A = arrays.matrix(A, "A", (n, n))
    B = arrays.matrix(B, "B", (n, None))
    C = arrays.matrix(C, "C", (None, n))
    shape = (C.shape[0], B.shape[1])
    D = np.zeros(shape) if D is None else arrays.matrix(D, "D", shape)
    # only the units of states may change: norms depend on those of inputs and outputs
    T = scaling(A, B, C, D, sampled=dt > 0).states
    A, B, C = A / T[:, None] * T, B / T[:, None], C * T
    poles = np.linalg.eigvals(A).astype(complex) if n else np.zeros(0, complex)
    stable = is_stable_mode(poles, dt)
    if not stable.all():
        raise ModelError(f"the norm is infinite: the system has the unstable pole {describe_modes(poles[~stable][:1])}")
    size_B, size_C = float(np.linalg.norm(B)), float(np.linalg.norm(C))
    even = float(power_near(np.sqrt(size_B / size_C))) if size_B and size_C else 1.0
    return _System(A, B / even, C * even, D, dt, poles)


def _first_frequencies(system: _System) -> list[float]:
    """Return where the peak is likely: at the resonances, at both ends and in between."""
    if system.dt:
        # Poles at 0 have no frequency.
        poles = system.poles[np.abs(system.poles) > 1e-8]
        return [0.0, *np.abs(np.angle(poles)).tolist(), *np.linspace(0.1, np.pi, 16).tolist()]
    sizes = np.abs(system.poles)
    grid = np.geomspace(sizes.min() / 3, sizes.max() * 3, 16)
    return [0.0, np.inf, *np.abs(system.poles.imag).tolist(), *sizes.tolist(), *grid.tolist()]


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
    system = _stable_system(A, B, C, D, dt)
    per_second = 1 / system.dt if system.dt else 1.0
    if not system.A.size or not system.B.size or not system.C.size:
        return PeakGain(spectral_norm(system.D), 0.0)
    best, where = max((system.gain(theta), -theta) for theta in _first_frequencies(system))
    where = -where
    if best <= np.finfo(float).tiny:
        # At so many points only a zero transfer matrix is zero; its pencil would be singular.
        return PeakGain(best, 0.0)
    # Unit gain at the best point so far keeps the two halves of the pencil alike.
    root = np.sqrt(best)
    unit = _System(system.A, system.B / root, system.C / root, system.D / best, system.dt, system.poles)
    level = 1.0
    for _ in range(60):
        target = level * (1 + rtol)
        points = unit.crossings(target)
        tries = np.concatenate([points, (points[1:] + points[:-1]) / 2, np.sqrt(points[1:] * points[:-1])])
        gains = [unit.gain(theta) for theta in tries]
        if not gains or max(gains) < target:
            top, where = _climb(unit, where, level)
            return PeakGain(top * best, float(where * per_second))
        level, where = max(gains), float(tries[int(np.argmax(gains))])
    raise AccuracyError(f"the peak gain did not settle in 60 iterations: {level * best:.9g} so far; use a larger rtol")


def _climb(system: _System, where: float, level: float) -> tuple[float, float]:
    """Climb to the top of the peak next to ``where`` by golden sections, in a bracket of a thousandth."""
    if not where or np.isinf(where):
        return level, where
    low, high = where * (1 - 1e-3), where * (1 + 1e-3)
    if system.dt:
        high = min(high, np.pi)
    ratio = (np.sqrt(5) - 1) / 2
    for _ in range(25):
        left, right = high - ratio * (high - low), low + ratio * (high - low)
        if system.gain(left) < system.gain(right):
            low = left
        else:
            high = right
    top = system.gain((low + high) / 2)
    return (top, (low + high) / 2) if top > level else (level, where)


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
    system = _stable_system(A, B, C, D, dt)
    if not system.dt and np.any(system.D):
        return float("inf")
    direct = float(np.sum(system.D**2))
    if not system.A.size or not system.B.size or not system.C.size:
        return float(np.sqrt(direct))
    return float(np.sqrt(max(np.sum((system.C @ _gramian(system)) * system.C) + direct, 0.0)))


def _gramian(system: _System) -> Matrix:
    A, W = system.A, system.B @ system.B.T
    if system.dt:
        # Smith's doubling: squares A, keeps X positive; a pole at 1 - 1e-15 takes 55 steps.
        X, power = W, A
        for _ in range(60):
            step = power @ X @ power.T
            X = X + step
            if np.linalg.norm(step) <= 1e-17 * np.linalg.norm(X):
                break
            power = power @ power
        rest = A @ X @ A.T - X + W
        size = np.linalg.norm(X) * (1 + np.linalg.norm(A) ** 2) + np.linalg.norm(W)
    else:
        X = scipy.linalg.solve_continuous_lyapunov(A, -W)
        rest = A @ X + X @ A.T + W
        size = 2 * np.linalg.norm(X) * np.linalg.norm(A) + np.linalg.norm(W)
    if not np.all(np.isfinite(X)) or np.linalg.norm(rest) > 1e-10 * size:
        raise AccuracyError(
            "the Lyapunov equation of the norm was not solved; a pole is too near to the stability boundary"
        )
    return X
