r"""Initial state of a filter, estimated from its first residuals by least squares.

A filter that starts with an error :math:`e_0` has without faults the residual :math:`r_k = C A^k e_0` and noise. What
the first ``N`` of them say of :math:`e_0` is taken out of the state after them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from residua.decide.row_norms import row_norms
from residua.decide.test import ResidualTest
from residua.design import ResidualGenerator
from residua.errors import SettingError
from residua.linear.systems.recursion import ordered_product
from residua.linear.systems.scaling import scaling
from residua.visible import echo

#: How a filter starts: from rest at the first sample, or with the state that its first residuals show.
STARTS = ("estimated", "rest")

#: How far the estimate of a start moves a residual, in units of its threshold, from which on that is remembered: a
#: diagnosis says it, since a fault at the first sample may have been taken for a start.
MOVED_FROM = 0.1
#: Samples that a start is estimated from at most.
MOST_SAMPLES = 2000
#: Numbers that such an estimate may cost once, in multiplications.
_MOST_WORK = 10**9
#: Part of the largest singular value below which nothing is known of a direction.
_KNOWN = 1e-7
#: Variance, in units of that of one residual, that the estimate may add to any later one.
_ADDED = 1.0


@dataclass(frozen=True, eq=False)
class StartFit:
    """Estimator of the initial state.

    Attributes
    ----------
    samples : int
        How many of the first residuals are looked at.
    A, C : of the filter.
    weights : ndarray, shape (residuals, k)
        ``r @ weights`` are of comparable size.
    ratios : ndarray, shape (residuals, k)
        ``r @ ratios`` are in units of the threshold.
    correction : ndarray, shape (n, n)
        From the sum of products to the correction of the state after these samples.
    """

    samples: int
    A: NDArray[np.float64]
    C: NDArray[np.float64]
    weights: NDArray[np.float64]
    ratios: NDArray[np.float64]
    correction: NDArray[np.float64]

    @cached_property
    def rows(self) -> NDArray[np.float64]:
        """Products of each residual, at each sample after the start, with its response to the error: (N, nr, n)."""
        out = np.empty((self.samples, *self.C.shape))
        response = self.C
        for k in range(self.samples):
            out[k] = ordered_product(self.weights, ordered_product(self.weights.T, response))
            response = ordered_product(response, self.A)
        return out

    def add(self, sums: NDArray[np.float64], residuals: NDArray[np.float64], age: int) -> NDArray[np.float64]:
        """Return the sums of products after further samples, in the order of time.

        Parameters
        ----------
        sums : ndarray, shape (plants, n)
        residuals : ndarray, shape (plants, time, residuals)
        age : int
            Samples since the start, before these.
        """
        rows = self.rows[age : age + residuals.shape[1]]
        steps = np.zeros((*residuals.shape[:2], self.C.shape[1]))
        for i in range(rows.shape[1]):
            steps += residuals[:, :, i, None] * rows[:, i]
        return np.cumsum(np.concatenate([sums[:, None], steps], axis=1), axis=1)[:, -1]

    def corrected(self, x: NDArray[np.float64], sums: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
        """Return states corrected for the effect of the start, and the size of the move of the next residual.

        In units of the threshold, zero where it is less than :data:`MOVED_FROM`; both for every plant.
        """
        left = ordered_product(sums, self.correction.T)
        moved = ordered_product(ordered_product(left, self.C.T), self.ratios)
        far = row_norms(moved)
        return x - left, np.where(far >= MOVED_FROM, far, 0.0)


def checked_start(value: object) -> str:
    """Return the setting ``start`` of a monitor."""
    if value not in STARTS:
        raise SettingError(f"start must be 'estimated' or 'rest', got {echo(value)}")
    return str(value)


def start_fit(generator: ResidualGenerator, test: ResidualTest, settle: int) -> StartFit | None:
    """Return an estimator of the start from the samples in which the filter settles; ``None`` if there is none."""
    system = generator.system
    n = system.n_states
    samples = min(settle, MOST_SAMPLES, max(n, _MOST_WORK // max(1, len(system.C) * n * n)))
    if not n or not samples or not np.any(system.C):
        return None
    A, C = system.A, system.C
    weights = _known_weights(test)
    if weights is None:  # in units of the states that come to the same whatever those of the plant are
        T = scaling(A, np.zeros((n, 0)), C, np.zeros((len(C), 0)), sampled=True).states
        weights = _weights_by_size(C * T, A / T[:, None] * T, samples)
    blocks, block = [], weights.T @ C
    for _ in range(samples):
        blocks.append(block)
        block = block @ A
    seen = np.concatenate(blocks)
    units = np.linalg.norm(seen, axis=0)  # states in units of their effect on residuals
    units = np.where(units > 0, 1 / np.where(units > 0, units, 1.0), 0.0)
    after = [block]  # effect of the initial state on later residuals, at ever longer intervals
    power = A
    for _ in range(24):
        after.append(after[-1] @ power)
        power = power @ power
    _, values, directions = np.linalg.svd(seen * units, full_matrices=False)
    rank = int(np.count_nonzero(values > _KNOWN * values[0])) if values[0] > 0 else 0
    while rank:
        inverse = units[:, None] * directions[:rank].T / values[:rank]
        added = max(float(np.linalg.norm(later @ inverse, axis=1).max()) for later in after)
        if added**2 <= _ADDED:
            break
        rank -= 1
    if not rank:
        return None
    carried = np.linalg.matrix_power(A, samples) @ inverse @ inverse.T
    return StartFit(samples, A, C, weights, test.per_threshold, carried)


def _known_weights(test: ResidualTest) -> NDArray[np.float64] | None:
    """Return the whitening, which makes residuals comparable, if there is one."""
    units = test.per_deviation
    return None if units is None or np.array_equal(units, np.eye(len(units))) else units


def _weights_by_size(C: NDArray, A: NDArray, samples: int) -> NDArray[np.float64]:
    """Return weights that make residuals comparable by their response to a start."""
    size, block = np.zeros(len(C)), C
    for _ in range(samples):
        size = size + np.sum(block**2, axis=1)
        block = ordered_product(block, A)
    return np.diag(1 / np.sqrt(np.where(size > 0, size, 1.0)))
