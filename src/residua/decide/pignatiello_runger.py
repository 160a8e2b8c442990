"""Run lengths of Pignatiello and Runger's vector CUSUM, whose allowance grows with the samples that are summed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from residua.decide.gaussian_norm import norm_above, norm_density
from residua.decide.run_lengths import nodes_of, settled
from residua.errors import SettingError

Values = NDArray[np.float64]

#: Sums of more samples than that many over the square of the allowance are no chance any more.
_LONGEST = 60.0
#: Most samples in a sum that are followed one by one.
_MOST = 20_000


def run_length_of_mc1(allowance: float, dimension: int, threshold: float) -> float:
    r"""Return the mean number of samples to a false alarm from a start at zero.

    .. math:: L_n(c) = 1 + P_0 L_0 + \int p(c' | c) L_{n+1}(c')\, dc', \qquad
       \kappa (n + 1) < c' < \kappa (n + 1) + h

    for the length :math:`c` of the sum of :math:`n` samples, which is backwards from a number of samples that no sum
    has by chance. The dimension of the residual and unit covariance as for
    :class:`residua.decide.vector_run_lengths.LengthChain`.

    Parameters
    ----------
    allowance : float
    dimension : int
    threshold : float

    References
    ----------
    Pignatiello and Runger (1990), Journal of Quality Technology 22(3), 173-186 (the test).
    """
    longest = int(np.ceil(_LONGEST / allowance**2 + threshold / allowance))
    if longest > _MOST:
        raise SettingError(
            f"a shift of {2 * allowance:.3g} is too small for Pignatiello and Runger's sums, which would be of "
            f"{longest} samples: take form='crosier'"
        )

    def solve(factor: float) -> float:
        nodes, weights = nodes_of(threshold, 1.0, factor)
        after = np.ones(len(nodes)), np.zeros(len(nodes))  # L = a + b L_0
        for n in range(longest, 0, -1):
            now, then = allowance * n + nodes, allowance * (n + 1) + nodes
            step = norm_density(then[None, :], now[:, None], dimension) * weights
            none = 1 - norm_above(allowance * (n + 1), now, dimension)
            after = 1 + step @ after[0], none + step @ after[1]
        first = norm_density(allowance + nodes, np.zeros(len(nodes)), dimension) * weights
        none = 1 - norm_above(allowance, np.zeros(1), dimension)[0]
        return float((1 + first @ after[0]) / (1 - none - first @ after[1]))

    return settled(solve, f"a threshold of {threshold:.6g}")


def delay_of_mc1(allowance: float, dimension: int, threshold: float, shift: float, *, runs: int = 20_000) -> float:
    """Return the mean number of samples to an alarm from a start at zero, after a step: by simulation, seeded."""
    rng = np.random.default_rng(0)
    total, count, left = np.zeros((runs, dimension)), np.zeros(runs), np.arange(runs)
    samples = 0
    for now in range(1, 1_000_000):
        samples += len(left)
        e = rng.standard_normal((len(left), dimension))
        e[:, 0] += shift
        total[left] += e
        count[left] += 1
        over = np.linalg.norm(total[left], axis=1) - allowance * count[left]
        zero = left[over <= 0]
        total[zero], count[zero] = 0.0, 0.0
        left = left[over <= threshold]
        if not len(left):
            return samples / runs
        if now * len(left) > 1e9:
            break
    raise SettingError(f"a step of {shift:.3g} deviations is seen too seldom for a mean of runs")


__all__ = ["delay_of_mc1", "run_length_of_mc1"]
