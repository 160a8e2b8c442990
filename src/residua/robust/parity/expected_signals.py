"""The signals of a plant in fault-free operation, as a random ensemble: what windows of samples are made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua.design.core.evidence import format_pole
from residua.errors import AccuracyError, DesignError, SettingError
from residua.linear import StateSpace
from residua.plant import Plant

#: Sizes of signals: one for all, one each, by name (others one), or a covariance.
Sizes = float | ArrayLike | Mapping[str, float]
#: Doublings of the time over which covariances are summed: 2^60 samples.
_DOUBLINGS = 60


@dataclass(frozen=True, eq=False)
class ExpectedSignals:
    r"""Random inputs and disturbances of known size, and the states that go with them.

    The signals :math:`v = (u, d)` are a stationary first-order process, :math:`v_{t+1} = \rho v_t +
    \sqrt{1 - \rho^2} L e_t` with white ``e`` of unit covariance, so that their covariance is :math:`L L^T` whatever
    :math:`\rho`; with :math:`\rho = 0` they are white. The noise of the plant is white.

    Attributes
    ----------
    inputs, disturbances : Sizes or None
        Root mean squares, or covariances; one when ``None``.
    states : Sizes or None
        Of the state at the begin of a window, then independent of the inputs; ``None`` for the stationary state that
        these signals make.
    correlation_time : float
        Seconds over which inputs and disturbances stay alike, :math:`\rho = e^{-\Delta t / T}`.
    noise : bool
        Whether the noise of the plant counts too.
    """

    inputs: Sizes | None = None
    disturbances: Sizes | None = None
    states: Sizes | None = None
    correlation_time: float = 0.0
    noise: bool = False

    def __post_init__(self) -> None:
        """Check the settings."""
        T = self.correlation_time
        if not isinstance(T, (int, float)) or not isfinite(T) or T < 0:
            raise SettingError(f"correlation_time must be seconds, zero or more, got {T!r}")

    def driven(self, plant: Plant) -> DrivenPlant:
        """Return a plant with what drives it."""
        n, m = plant.n_states, plant.n_outputs
        L = scipy.linalg.block_diag(
            size_factor(self.inputs, plant.inputs, "input"),
            size_factor(self.disturbances, plant.disturbances, "disturbance"),
        )
        k, p = len(L), len(plant.inputs)
        rho = float(np.exp(-plant.dt / self.correlation_time)) if self.correlation_time else 0.0
        B, D = np.hstack([plant.B, plant.Bd]), np.hstack([plant.D, plant.Dd])
        Bw, Dw = (plant.Bw, plant.Dw) if self.noise else (plant.Bw[:, :0], plant.Dw[:, :0])
        w = Bw.shape[1]
        A = np.block([[plant.A, B], [np.zeros((k, n)), rho * np.eye(k)]])
        G = np.block([[Bw, np.zeros((n, k))], [np.zeros((k, w)), np.sqrt(1 - rho**2) * L]])
        C = np.block([[plant.C, D], [np.zeros((p, n)), np.eye(p, k)]])
        H = np.vstack([np.hstack([Dw, np.zeros((m, k))]), np.zeros((p, w + k))])
        first = self.states
        if first is not None:
            first = scipy.linalg.block_diag(size_factor(first, plant.states, "state"), L)
        return DrivenPlant(A, G, C, H, first, plant)


@dataclass(frozen=True, eq=False)
class DrivenPlant:
    """``xi+ = A xi + G e``, ``(y, u) = C xi + H e`` with white ``e`` of unit covariance; ``xi`` holds states, signals.

    ``first`` is a factor of the covariance of ``xi`` at the begin of a window, ``None`` for the stationary one.
    """

    A: NDArray[np.float64]
    G: NDArray[np.float64]
    C: NDArray[np.float64]
    H: NDArray[np.float64]
    first: NDArray[np.float64] | None
    plant: Plant

    def begin(self, name: str) -> NDArray[np.float64]:
        """Return a factor of the covariance of ``xi`` at the begin of a window; raises when there is none."""
        if self.first is not None:
            return self.first
        worst = max(np.linalg.eigvals(self.plant.A), key=abs, default=0.0)
        if abs(worst) >= 1:
            raise DesignError(
                f"{name} has the pole {format_pole(worst)}, which is not stable: its states have no stationary size; "
                "give their sizes, states=..., or the plant in its closed loop"
            )
        return stationary_factor(self.A, self.G, name)

    def window(self, order: int, name: str) -> NDArray[np.float64]:
        """Return ``M`` with ``[Y; U] = M z``, ``z`` white: rows by samples, oldest first, each ``y`` then ``u``.

        The samples are formed by stepping the factor of the covariance: no power of ``A`` grows that the signals of
        the plant do not grow by themselves.
        """
        X = self.begin(name)
        count = X.shape[1] + (order + 1) * self.G.shape[1]
        state = np.zeros((len(self.A), count))
        state[:, : X.shape[1]] = X
        rows, at = [], X.shape[1]
        for _ in range(order + 1):
            now = self.C @ state
            now[:, at : at + self.H.shape[1]] += self.H
            rows.append(now)
            state = self.A @ state
            state[:, at : at + self.G.shape[1]] += self.G
            at += self.G.shape[1]
        return np.vstack(rows)

    def spread_of(self, system: StateSpace, name: str) -> NDArray[np.float64] | None:
        """Return the root mean square of the output of a filter of ``(u, y)``; ``None`` without a stationary one.

        Each output of the filter on its own.
        """
        if self.first is not None and system.n_states:
            return None
        B, D = (np.roll(M, -len(self.plant.inputs), axis=1) for M in (system.B, system.D))
        A = np.block([[self.A, np.zeros((len(self.A), system.n_states))], [B @ self.C, system.A]])
        G = np.vstack([self.G, B @ self.H])
        C, H = np.hstack([D @ self.C, system.C]), D @ self.H
        self.begin(name)
        S = stationary_factor(A, G, name) if self.first is None else self.first
        return np.sqrt(((C @ S) ** 2).sum(axis=1) + (H**2).sum(axis=1))


def stationary_factor(A: NDArray[np.float64], G: NDArray[np.float64], name: str) -> NDArray[np.float64]:
    r"""Return ``S`` with :math:`S S^T = \sum_j A^j G G^T (A^T)^j`, by doubling and orthogonal compression.

    The factor itself is summed, so that directions of little variance keep their digits.
    """

    def compressed(S: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return a factor with no more columns than rows and the same product with its transpose."""
        return S if S.shape[1] <= S.shape[0] else np.asarray(np.linalg.qr(S.T, mode="r")).T

    S, power = compressed(G), A
    for _ in range(_DOUBLINGS):
        more = power @ S
        if not np.isfinite(more).all():
            break
        done = bool(np.all(np.linalg.norm(more, axis=1) <= 1e-16 * np.linalg.norm(S, axis=1)))
        S = compressed(np.hstack([S, more]))
        if done:
            return S
        power = power @ power
    raise AccuracyError(
        f"the stationary covariance of the states of {name} does not converge: give their sizes, states="
    )


def size_factor(value: Sizes | None, names: Sequence[str], what: str) -> NDArray[np.float64]:
    """Return ``L`` with the covariance ``L L'`` of signals of these sizes.

    Raises
    ------
    SettingError
        If the shape does not fit, a name is unknown, a size is negative or a covariance not semidefinite.
    """
    n = len(names)
    if value is None:
        return np.eye(n)
    if isinstance(value, Mapping):
        unknown = [str(name) for name in value if name not in names]
        if unknown:
            raise SettingError(f"there is no {what} {unknown[0]!r}; there are {', '.join(names) or 'none'}")
        value = [value.get(name, 1.0) for name in names]
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise SettingError(f"sizes of {what}s must be numbers: {error}") from error
    if not np.isfinite(array).all():
        raise SettingError(f"sizes of {what}s must be finite")
    if array.ndim < 2:
        if array.shape not in ((), (n,)) or np.any(array < 0):
            raise SettingError(f"give one size for all {what}s or one for each of {n}, none negative, got {value!r}")
        return np.diag(np.broadcast_to(array, (n,)))
    if array.shape != (n, n) or not np.allclose(array, array.T, rtol=1e-9, atol=0):
        raise SettingError(f"the covariance of the {what}s must be symmetric, {n} x {n}, got shape {array.shape}")
    spread = np.sqrt(np.maximum(np.diag(array), 0.0))
    units = np.where(spread > 0, spread, 1.0)
    values, vectors = np.linalg.eigh(array / units[:, None] / units)
    if np.any(values < -1e-10 * max(n, 1)):
        raise SettingError(f"the covariance of the {what}s is not positive semidefinite")
    return units[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
