"""Run lengths of statistics that are the length of a vector: of vector CUSUMs, and of the vector EWMA."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from residua.decide.gaussian_norm import norm_above, norm_density
from residua.decide.run_lengths import NEARLY, Chain, Values, mean_run_length, nodes_of, settled
from residua.errors import SettingError

#: Nodes to each deviation of a step along a radius and along the largest arc, and the least and the most of each.
_ON_RADIUS, _ON_ARC, _FEWEST, _MOST = 1.7, 1.2, 12, 96
#: Residuals up to which run lengths after a shift are computed on the way to something else: it takes seconds beyond.
MOST_DIMENSIONS = 3
#: Sums of more samples than that many over the square of the allowance are beyond chance.
_LONGEST_SUM = 60.0
#: A step whose density is less than the exponential of minus this is none: 1e-20, far below any effect.
_NEVER = 46.0
#: Most samples in a sum that are followed one by one.
_MOST_IN_A_SUM = 20_000


@dataclass(frozen=True)
class LengthChain(Chain):
    r"""Length of a vector with Gaussian increments.

    .. math:: v_k = c\, s_{k-1} + q_k, \qquad |s_k| = g \max(|v_k| - \kappa, 0), \quad s_k \parallel v_k

    Crosier's vector CUSUM has :math:`c = g = 1` and his allowance :math:`\kappa`; the vector EWMA of weight
    :math:`\lambda` has :math:`c = (1 - \lambda) / \lambda`, :math:`g = \lambda` and no allowance.

    Attributes
    ----------
    dimension : int
        Of the vectors; their covariance is the identity.
    kept, gain, allowance : float
        c, g and kappa.
    """

    dimension: int
    kept: float = 1.0
    gain: float = 1.0
    allowance: float = 0.0

    @property
    def width(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Standard deviation of a step."""
        return self.gain

    def density(self, now: Values, then: Values) -> Values:
        """Return the density of the next length."""
        return norm_density(then / self.gain + self.allowance, self.kept * now, self.dimension) / self.gain

    def above(self, now: Values, level: float) -> Values:
        """Return the probability that the next length is above a level."""
        return norm_above(level / self.gain + self.allowance, self.kept * now, self.dimension)

    def at_zero(self, now: Values) -> Values:
        """Return the probability that the next vector is zero."""
        if not self.allowance:
            return np.zeros_like(now)
        return 1 - norm_above(self.allowance, self.kept * now, self.dimension)


@lru_cache(maxsize=256)
def shifted_run_length(chain: LengthChain, threshold: float, shift: float) -> float:
    """Return the mean number of samples to the threshold from a start at zero, for vectors with a mean.

    By a quadrature over the part of the vector along the mean and the length of the rest: as polar coordinates, in
    which the density is smooth where an allowance leaves a hole in the middle.

    Parameters
    ----------
    chain : LengthChain
    threshold : float
    shift : float
        Length of the mean, in standard deviations.

    References
    ----------
    Rigdon (1995), Journal of Statistical Computation and Simulation 52(4) (the vector EWMA); Crosier (1988),
    Technometrics 30(3).

    Examples
    --------
    >>> weight = 0.1
    >>> chain = LengthChain(4, kept=(1 - weight) / weight, gain=weight)
    >>> round(shifted_run_length(chain, (12.73 * weight / (2 - weight)) ** 0.5, 1.0), 1)
    12.2
    """
    if not shift:
        return mean_run_length(chain, threshold)
    return settled(
        lambda factor: _run_length(chain, threshold, shift, factor), f"a threshold of {threshold:.6g}", NEARLY
    )


def _run_length(chain: LengthChain, threshold: float, shift: float, factor: float) -> float:
    along, across, lengths, weights = _points(chain, threshold, factor)
    image = lengths / chain.gain + chain.allowance  # the length of v that becomes each length
    share = np.divide(along, lengths)
    mean = chain.kept * np.concatenate([[0.0], along]) + shift
    rest = chain.kept * np.concatenate([[0.0], across])
    side = image * np.sqrt(np.maximum(1 - share**2, 0.0))
    away = (image * share - mean[:, None]) ** 2 / 2 + (side - rest[:, None]) ** 2 / 2
    now, then = np.nonzero(away < _NEVER)
    density = np.exp(-(((image * share)[then] - mean[now]) ** 2) / 2) / np.sqrt(2 * np.pi)
    if chain.dimension > 1:
        density *= norm_density(side[then], rest[now], chain.dimension - 1) * image[then]
    steps = np.zeros((len(mean), len(mean)))
    steps[now, then + 1] = density * weights[then] / chain.gain
    steps[:, 0] = 1 - norm_above(chain.allowance, np.hypot(mean, rest), chain.dimension) if chain.allowance else 0.0
    return float(np.linalg.solve(np.eye(len(mean)) - steps, np.ones(len(mean)))[0])


def _points(chain: LengthChain, threshold: float, factor: float) -> tuple[Values, Values, Values, Values]:
    """Return the nodes, along and across the mean, their lengths and their weights."""
    if chain.dimension == 1:
        lengths, weights = nodes_of(threshold, chain.width, factor)
        return np.concatenate([lengths, -lengths]), np.zeros(2 * len(lengths)), np.tile(lengths, 2), np.tile(weights, 2)
    lengths, inward = _quadrature(threshold, _ON_RADIUS * threshold / chain.gain, factor)
    angles, around = _quadrature(np.pi, _ON_ARC * np.pi * (threshold / chain.gain + chain.allowance), factor)
    length, angle = (grid.ravel() for grid in np.meshgrid(lengths, angles, indexing="ij"))
    weight = np.outer(inward, around).ravel()
    return length * np.cos(angle), length * np.sin(angle), length, weight


def _quadrature(length: float, wanted: float, factor: float) -> tuple[Values, Values]:
    count = int(np.ceil(factor * min(max(wanted, _FEWEST), _MOST)))
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return length * (nodes + 1) / 2, length * weights / 2


def run_length_of_mc1(allowance: float, dimension: int, threshold: float) -> float:
    r"""Return the mean number of samples to a false alarm from a start at zero.

    .. math:: L_n(c) = 1 + P_0 L_0 + \int p(c' | c) L_{n+1}(c')\, dc', \qquad
       \kappa (n + 1) < c' < \kappa (n + 1) + h

    for the length :math:`c` of the sum of :math:`n` samples, which is backwards from a number of samples that no sum
    has by chance. The dimension of the residual and unit covariance as for
    :class:`LengthChain`.

    Parameters
    ----------
    allowance : float
    dimension : int
    threshold : float

    References
    ----------
    Pignatiello and Runger (1990), Journal of Quality Technology 22(3), 173-186 (the test).
    """
    longest = int(np.ceil(_LONGEST_SUM / allowance**2 + threshold / allowance))
    if longest > _MOST_IN_A_SUM:
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


__all__ = ["MOST_DIMENSIONS", "LengthChain", "delay_of_mc1", "run_length_of_mc1", "shifted_run_length"]
