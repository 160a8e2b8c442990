"""Residuals that ignore parameters, evaluated as data arrive: a pure function of a state and a block of samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.systems.recursion import ordered_product, run_filter


@dataclass(frozen=True, eq=False)
class ParameterState:
    """What running remembers: filter state, mean squares, their weights (a row per plant), and samples so far."""

    x: NDArray[np.float64]
    squares: NDArray[np.float64]
    weights: NDArray[np.float64]
    count: int


@dataclass(frozen=True, eq=False)
class ParameterResiduals:
    """What came of a block of samples.

    Attributes
    ----------
    primary : ndarray, shape (plants, time, equations)
        The primary residuals times ``scale``: in units of the noise once it is known, before that of what expected
        changes of the parameters do.
    sensitivities : ndarray, shape (plants, time, parameters, equations)
        Their derivatives, times the expected change of each parameter.
    residuals : ndarray, shape (plants, time, members, equations)
        The rest of these without the directions of the ignored parameters.
    statistic : ndarray, shape (plants, time, members)
        Their root mean square over the memory; NaN before the filter has settled.
    fired : ndarray of bool, shape (plants, time, members)
        Whether it is over the threshold; all false before thresholds are known.
    """

    primary: NDArray[np.float64]
    sensitivities: NDArray[np.float64]
    residuals: NDArray[np.float64]
    statistic: NDArray[np.float64]
    fired: NDArray[np.bool_]


def without_directions(e: NDArray[np.float64], directions: NDArray[np.float64], rest: float) -> NDArray[np.float64]:
    r"""Return :math:`(I - \Pi (\Pi^T \Pi + \epsilon^2 I)^{-1} \Pi^T)\, e` at every sample.

    With :math:`[\Pi;\, \epsilon I] = [Q_1;\, Q_2] R` the matrix taken off is :math:`Q_1 Q_1^T`: nothing is squared, and
    there is no rank to decide. Every sample is computed by itself, whatever the block that it comes in.

    Parameters
    ----------
    e : ndarray, shape (..., equations)
    directions : ndarray, shape (..., parameters, equations)
        The rows are the columns of :math:`\Pi`.
    rest : float
        :math:`\epsilon`, positive.
    """
    k, m = directions.shape[-2:]
    if not k:
        return e
    stacked = np.zeros((*directions.shape[:-2], m + k, k))
    stacked[..., :m, :] = np.swapaxes(directions, -1, -2)
    stacked[..., m:, :] = rest * np.eye(k)
    Q = np.linalg.qr(stacked)[0][..., :m, :]
    out = e
    parts = np.zeros((*e.shape[:-1], k))
    for i in range(m):  # sums in one order, whatever the block
        parts = parts + Q[..., i, :] * e[..., i, None]
    for j in range(k):
        out = out - Q[..., :, j] * parts[..., j, None]
    return out


@dataclass(frozen=True, eq=False)
class ParameterRunning:
    """Everything that running needs and that never changes."""

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]
    scale: NDArray[np.float64]
    changes: NDArray[np.float64]
    ignored: tuple[tuple[int, ...], ...]
    rest: float
    memory: int
    settle: int
    thresholds: NDArray[np.float64]

    def initial_state(self, plants: int) -> ParameterState:
        """Return the state before the first sample."""
        mean = np.zeros((plants, len(self.ignored)))
        return ParameterState(np.zeros((plants, len(self.A))), mean, mean, 0)

    def largest_gains(self) -> NDArray[np.float64]:
        """Return the sums of the sizes of the weights of each signal in each primary residual."""
        m = len(self.scale)
        gains, state = np.abs(self.D[:m]), self.B
        for _ in range(self.settle):
            gains = gains + np.abs(self.C[:m] @ state)
            state = self.A @ state
        return gains

    def block(self, state: ParameterState, data: NDArray[np.float64]) -> tuple[ParameterState, ParameterResiduals]:
        """Run over a block, shape (plants, time, inputs then outputs)."""
        plants, time, _ = data.shape
        x, v = run_filter(self.A, self.B, self.C, self.D, state.x, data)
        m, q, members = len(self.scale), len(self.changes), len(self.ignored)
        scaled = ordered_product(v.reshape(plants, time, 1 + q, m), self.scale)
        e, pi = scaled[:, :, 0], scaled[:, :, 1:] * self.changes[:, None]
        r = np.zeros((plants, time, members, m))
        for j, chosen in enumerate(self.ignored):
            r[:, :, j] = without_directions(e, pi[:, :, list(chosen)], self.rest)
        squares = np.zeros((plants, time, members))
        for i in range(m):
            squares = squares + r[..., i] ** 2
        usable = np.arange(state.count, state.count + time) >= self.settle
        weights = np.broadcast_to(usable[None, :, None].astype(float), squares.shape)
        both = np.concatenate([squares * weights, weights], axis=2)
        fade, eye = 1 - 1 / self.memory, np.eye(2 * members)
        start = np.concatenate([state.squares, state.weights], axis=1)
        # the mean after each sample is the state after it: fade times the old one plus the new square
        end, mean = run_filter(fade * eye, eye, fade * eye, eye, start, both)
        total, weight = mean[..., :members], mean[..., members:]
        degrees = np.array([max(m - len(chosen), 1) for chosen in self.ignored], dtype=float)
        with np.errstate(divide="ignore", invalid="ignore"):
            statistic = np.where(weight > 0, np.sqrt(total / weight / degrees), np.nan)
        fired = np.where(np.isnan(statistic), -np.inf, statistic) > self.thresholds
        after = ParameterState(x, end[:, :members], end[:, members:], state.count + time)
        return after, ParameterResiduals(e, pi, r, statistic, fired)
