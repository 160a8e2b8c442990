"""Run lengths: mean numbers of samples of sequential statistics to their threshold, by integral equation."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError, SettingError

Values = NDArray[np.float64]

#: Nodes of the quadrature to each deviation of a step, and the least and the most of them.
_NODES_PER_DEVIATION, _FEWEST, _MOST = 4.0, 24, 1200
#: Mean run lengths beyond this have too few digits left.
LONGEST = 1e10
#: How far a larger number of nodes may move a run length, as a part of it.
_CONVERGED = 1e-6
#: The same for quantities that enter no design, and for densities with an edge.
NEARLY = 1e-3


class Chain(ABC):
    """Statistic whose next value depends on its present one alone: zero or more, and zero with positive probability.

    Attributes
    ----------
    width : float
        A length in which the density of the next value changes little: the standard deviation of a step.
    """

    width: float = 1.0

    @abstractmethod
    def density(self, now: Values, then: Values) -> Values:
        """Return the density of the next value at ``then``, above zero, given the present one; they broadcast."""

    @abstractmethod
    def above(self, now: Values, level: float) -> Values:
        """Return the probability that the next value is above a level, given the present one."""

    def at_zero(self, now: Values) -> Values:
        """Return the probability that the next value is zero, given the present one."""
        return np.zeros_like(now)


@dataclass(frozen=True)
class AlarmCycle:
    """Mean lengths of the quiet and the alarm between two false alarms.

    Attributes
    ----------
    quiet : float
        Mean number of samples from a start at zero to the one that raises an alarm, which is counted. The start is the
        sample that ended the alarm before.
    lasting : float
        Mean number of samples in alarm: that which raises it is counted, that which ends it is not.
    """

    quiet: float
    lasting: float

    @property
    def fraction(self) -> float:
        """The fraction of samples in alarm."""
        return self.lasting / (self.quiet + self.lasting)


@lru_cache(maxsize=1024)
def mean_run_length(chain: Chain, threshold: float, start: float = 0.0) -> float:
    r"""Return the mean number of samples until a statistic exceeds its threshold.

    .. math:: L(x) = 1 + P_0(x) L(0) + \int_0^h p(y | x) L(y)\, dy

    by Gauss and Legendre's quadrature at the nodes (Nyström's method), once more with a quarter more of them.

    Parameters
    ----------
    chain : Chain
    threshold : float
    start : float
        The statistic before the first sample.

    Raises
    ------
    SettingError
        If the mean is beyond 1e10 samples, where rounding leaves few digits.
    AccuracyError
        If more nodes change it by more than a millionth.

    References
    ----------
    Page (1954), Biometrika 41, eq. (5); Crowder (1987), Technometrics 29(4).

    Examples
    --------
    >>> from residua.decide.cusum import PageChain
    >>> round(mean_run_length(PageChain(allowance=0.5), 5.0), 3)
    930.887
    """
    return settled(lambda factor: _Grid(chain, threshold, factor).run_length(start), f"a threshold of {threshold:.6g}")


@lru_cache(maxsize=1024)
def run_frequency(chain: Chain, threshold: float) -> float:
    """Return the inverse of a mean run length; zero where it is too long to compute."""
    try:
        return 1 / mean_run_length(chain, threshold)
    except SettingError:
        return 0.0


@lru_cache(maxsize=1024)
def alarm_cycle(chain: Chain, threshold: float, release: float) -> AlarmCycle:
    """Return the mean lengths of quiet, from a start at zero, and of the alarm that follows.

    The alarm is on from the first value above ``threshold`` to that before the first at or below ``release``.
    """
    quiet = mean_run_length(chain, threshold)
    try:
        lasting = settled(lambda factor: _lasting(chain, threshold, release, factor), "the end of an alarm", NEARLY)
    except SettingError as error:
        raise SettingError(
            "the statistic hardly ever falls to where an alarm ends, so that no fraction of samples in alarm can be "
            "designed: give mean_time_between_false_alarms=, or a larger shift or weight for so many residuals"
        ) from error
    return AlarmCycle(quiet, lasting)


def threshold_of(run_length: Callable[[float], float], wanted: float, guess: float) -> float:
    """Return the threshold with a given mean run length, which grows with it.

    Parameters
    ----------
    run_length : callable
        Of a threshold.
    wanted : float
        Samples, more than 1.
    guess : float
        A threshold of about the right size.

    Raises
    ------
    SettingError
        If no threshold has it.
    """
    from scipy.optimize import brentq  # slow to import, and needed only here

    if not 1 < wanted <= LONGEST:
        raise SettingError(
            f"a mean time between false alarms of {wanted:.6g} samples cannot be designed: it must be above 1 and "
            f"at most {LONGEST:g}"
        )
    low = high = guess
    for _ in range(60):
        if _at_most(run_length, low, wanted):
            break
        low /= 2
    if not run_length(low) <= wanted:
        raise SettingError(
            f"every threshold has a longer time between false alarms than {wanted:.6g} samples: ask for a longer one, "
            "or for a smaller shift or drift"
        )
    high = max(low, guess if _at_most(run_length, guess, np.inf) else low)
    for _ in range(60):
        if run_length(high) >= wanted:
            break
        high *= 1.3
    goal = float(np.log(wanted))
    return float(brentq(lambda h: float(np.log(run_length(h))) - goal, low, high))


def _at_most(run_length: Callable[[float], float], threshold: float, wanted: float) -> bool:
    """Tell whether a threshold has a run length within a limit."""
    try:
        return run_length(threshold) <= wanted
    except SettingError:  # too long to compute
        return False


def settled(solve: Callable[[float], float], what: str, tolerance: float = _CONVERGED) -> float:
    """Return the result of a quadrature, checked against a quarter more nodes."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            coarse, fine = solve(1.0), solve(1.25)
    except np.linalg.LinAlgError as error:
        raise SettingError(
            f"the run length to {what} cannot be computed: for a shift or a drift of that size alarms are too rare at "
            "any threshold; take a smaller one, or NormThreshold"
        ) from error
    if not 0 < fine <= 1.01 * LONGEST:
        raise SettingError(f"{what} is reached once in more than {LONGEST:g} samples: that is beyond what is computed")
    if not abs(coarse - fine) <= (tolerance + np.finfo(float).eps * fine * 1e3) * fine:
        raise AccuracyError(
            f"the run length to {what} is {coarse:.8g} or {fine:.8g} samples by two quadratures: take a shift or "
            "weight that is not as small"
        )
    return fine


def nodes_of(length: float, width: float, factor: float) -> tuple[Values, Values]:
    """Return the nodes and weights of a quadrature from zero to a length, for a function that changes over a width."""
    wanted = int(np.ceil(factor * min(max(_NODES_PER_DEVIATION * length / width, _FEWEST), _MOST)))
    nodes, weights = np.polynomial.legendre.leggauss(wanted)
    return length * (nodes + 1) / 2, length * weights / 2


class _Grid:
    """A chain below its threshold, at zero and at the nodes of a quadrature."""

    def __init__(self, chain: Chain, threshold: float, factor: float) -> None:
        self.chain = chain
        nodes, weights = nodes_of(threshold, chain.width, factor)
        self.values = np.concatenate([[0.0], nodes])
        self.weights = np.concatenate([[1.0], weights])
        self.steps = self.probabilities(self.values)

    def probabilities(self, now: Values) -> Values:
        """Return the transition weights on the grid, with present values in rows."""
        out = self.chain.density(now[:, None], self.values[None, 1:]) * self.weights[1:]
        return np.column_stack([self.chain.at_zero(now), out])

    def run_length(self, start: float) -> float:
        mean = np.linalg.solve(np.eye(len(self.values)) - self.steps, np.ones(len(self.values)))
        return float(1 + self.probabilities(np.array([float(start)]))[0] @ mean) if start else float(mean[0])

    def visits(self) -> Values:
        """Return the expected visits to each value of the grid from a start at zero, up to the threshold."""
        first = np.zeros(len(self.values))
        first[0] = 1.0
        return np.asarray(np.linalg.solve(np.eye(len(self.values)) - self.steps.T, first), dtype=float)


def _lasting(chain: Chain, threshold: float, release: float, factor: float) -> float:
    """Return the mean number of samples from the first value above the threshold to one at or below the release."""
    below = _Grid(chain, threshold, factor)
    top = threshold + 12 * chain.width
    high, high_weights = nodes_of(top - threshold, chain.width, factor)
    low, low_weights = nodes_of(threshold - release, chain.width, factor)
    values = np.concatenate([low + release, high + threshold])
    weights = np.concatenate([low_weights, high_weights])
    stay = chain.density(values[:, None], values[None, :]) * weights
    stay[:, -1] += chain.above(values, top)  # values beyond stay at the top: they return nearly as soon
    mean = np.linalg.solve(np.eye(len(values)) - stay, np.ones(len(values)))
    entry = below.visits() @ chain.density(below.values[:, None], high[None, :] + threshold) * high_weights
    return float(entry @ mean[len(low) :] / entry.sum())


__all__ = [
    "LONGEST",
    "NEARLY",
    "AlarmCycle",
    "Chain",
    "alarm_cycle",
    "mean_run_length",
    "run_frequency",
    "threshold_of",
]
