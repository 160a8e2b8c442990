"""Probabilities of faults over time: a filter for the fault and its arrival, with its size unknown."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Belief:
    """Belief of the filter after a sample.

    Attributes
    ----------
    none : ndarray, shape (plants,)
        Logarithm of the probability that no fault is there.
    ages : ndarray, shape (plants, faults + 1, window)
        Of each fault, and of an unknown one, that it arrived 1, 2, ... samples ago; the last: as long ago or longer.
    sums : ndarray, shape (plants, faults + 1, window, k)
        Products of the residual with the response to each fault since then, in as many parts as it has dimensions.
    """

    none: NDArray[np.float64]
    ages: NDArray[np.float64]
    sums: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FaultFilter:
    r"""The posterior over faults and their arrivals.

    A fault arrives with its prior rate, adds :math:`\theta^T H_a` to the white residual at its age :math:`a`, with
    :math:`\theta \sim N(0, \sigma^2 I)`, and leaves again after ``duration`` samples on average. With
    :math:`y_a = \sum_{j \le a} H_j e_j` and :math:`J_a = \sum_{j \le a} H_j H_j^T` the likelihood ratio against no
    fault is, with :math:`\theta` integrated out,

    .. math:: \ln \Lambda_a = \tfrac12 y_a^T (J_a + \sigma^{-2} I)^{-1} y_a - \tfrac12 \ln \det(I + \sigma^2 J_a)

    Faults that are older than the window forget a part 1 / window of their sums with each sample.

    Attributes
    ----------
    responses : ndarray, shape (faults, p + 1, k)
        Of each fault at the ages 1, ..., p + 1 and later, in white residuals, for a step of one standard deviation.
    unknown : ndarray, shape (p + 1, k, k)
        The same of a step of each residual.
    rates : ndarray, shape (faults + 1,)
        Probability with which each arrives in a sample; last that of an unknown one.
    duration : float
    size : float
        :math:`\sigma`.
    window : int
    """

    responses: NDArray[np.float64]
    unknown: NDArray[np.float64]
    rates: NDArray[np.float64]
    duration: float
    size: float
    window: int

    def start(self, plants: int) -> Belief:
        """Return the belief that no fault is present."""
        shape = (plants, len(self.rates), self.window)
        return Belief(np.zeros(plants), np.full(shape, _NEVER), np.zeros((*shape, self.unknown.shape[-1])))

    def run(
        self, belief: Belief, e: NDArray[np.float64], seen: NDArray[np.bool_]
    ) -> tuple[Belief, NDArray[np.float64]]:
        """Return the belief after some samples, and the probabilities after each: faults, an unknown one, none.

        Parameters
        ----------
        belief : Belief
        e : ndarray, shape (plants, time, k)
        seen : ndarray of bool, shape (plants, time)
            Samples that are not seen change nothing.
        """
        out = np.zeros((*seen.shape, len(self.rates) + 1))
        for t in range(seen.shape[1]):
            after = self._step(belief, e[:, t])
            here = seen[:, t]
            belief = Belief(
                np.where(here, after.none, belief.none),
                np.where(here[:, None, None], after.ages, belief.ages),
                np.where(here[:, None, None, None], after.sums, belief.sums),
            )
            out[:, t, :-1] = np.exp(belief.ages).sum(axis=-1)
            out[:, t, -1] = np.exp(belief.none)
        return belief, out

    def _step(self, belief: Belief, e: NDArray[np.float64]) -> Belief:
        none = belief.none[:, None, None]
        added = (self._by_age * e[:, None, None, :, None]).sum(axis=-2)
        before = np.zeros_like(belief.sums)
        before[:, :, 1:] = belief.sums[:, :, :-1]
        arrived = np.full_like(belief.ages, 0.0)
        arrived[:, :, :1] = none + np.log(self.rates)[:, None]
        goes_on = np.log1p(-1.0 / self.duration)
        arrived[:, :, 1:] = belief.ages[:, :, :-1] + goes_on
        sums = before + added
        ages = arrived + self._evidence(sums, self._roots, self._constants)
        ages -= self._evidence(before, self._roots_before, self._constants_before)
        kept = belief.sums[:, :, -1:] * (1.0 - 1.0 / self.window)
        last = kept + added[:, :, -1:]
        stays = belief.ages[:, :, -1:] + goes_on
        stays = stays + self._evidence(last, self._roots[:, -1:], self._constants[:, -1:])
        stays = stays - self._evidence(kept, self._roots_before[:, -1:], self._constants_before[:, -1:])
        both = np.logaddexp(ages[:, :, -1:], stays)
        share = np.exp(stays - both)[..., None]
        sums[:, :, -1:] += share * (last - sums[:, :, -1:])
        ages[:, :, -1:] = both
        ended = _log_sum(belief.ages.reshape(len(e), -1)) - np.log(self.duration)
        quiet = np.logaddexp(belief.none + np.log1p(-self.rates.sum()), ended)
        whole = np.logaddexp(quiet, _log_sum(ages.reshape(len(e), -1)))
        return Belief(
            np.maximum(quiet - whole, _NEVER), np.maximum(ages - whole[:, None, None], _NEVER), np.asarray(sums)
        )

    @staticmethod
    def _evidence(
        sums: NDArray[np.float64], roots: NDArray[np.float64], constants: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the logarithm of the likelihood ratio against no fault."""
        return 0.5 * ((sums[..., :, None] * roots).sum(axis=-2) ** 2).sum(axis=-1) + constants

    @cached_property
    def _by_age(self) -> NDArray[np.float64]:
        """Responses, shape (faults + 1, window, k, k): only the first slice of a fault is not zero."""
        G, k = len(self.rates), self.unknown.shape[-1]
        ages = np.minimum(np.arange(self.window), self.unknown.shape[0] - 1)
        out = np.zeros((G, self.window, k, k))
        out[:-1, :, :, 0] = self.responses[:, ages]
        out[-1] = np.swapaxes(self.unknown, 1, 2)[ages]
        return out

    @cached_property
    def _information(self) -> NDArray[np.float64]:
        """Information on the size at the ages 0, 1, ..., window, without the prior."""
        H = self._by_age
        J = np.cumsum(np.einsum("gakd,gakc->gadc", H, H), axis=1)
        return np.concatenate([np.zeros_like(J[:, :1]), J], axis=1)

    @cached_property
    def _all_roots(self) -> NDArray[np.float64]:
        k = self.unknown.shape[-1]
        roots = np.linalg.cholesky(np.linalg.inv(self._information + np.eye(k) / self.size**2))
        return np.asarray(roots, dtype=float)

    @cached_property
    def _all_constants(self) -> NDArray[np.float64]:
        k = self.unknown.shape[-1]
        return np.asarray(-0.5 * np.linalg.slogdet(np.eye(k) + self.size**2 * self._information)[1], dtype=float)

    @property
    def _roots(self) -> NDArray[np.float64]:
        return self._all_roots[:, 1:]

    @property
    def _roots_before(self) -> NDArray[np.float64]:
        return self._all_roots[:, :-1]

    @property
    def _constants(self) -> NDArray[np.float64]:
        return self._all_constants[:, 1:]

    @property
    def _constants_before(self) -> NDArray[np.float64]:
        return self._all_constants[:, :-1]


#: Logarithm of a probability that counts as none: a number that files hold, and that one sample makes up for.
_NEVER = -10_000.0


def _log_sum(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the logarithm of the sum of the exponentials of each row."""
    most = rows.max(axis=1)
    return most + np.log(np.exp(rows - most[:, None]).sum(axis=1))


__all__ = ["Belief", "FaultFilter"]
