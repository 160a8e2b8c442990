"""Thresholds of matched filters: a bound on the false alarm rate over all hypotheses, or fitted to data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from residua.decide.matched import MatchedTest, empty_match, match_block, summed
from residua.decide.norm_threshold import (
    NormTest,
    NormThreshold,
    fit_norm_test,
    fitted_threshold,
    norm_test_from_model,
)
from residua.decide.seams import parts_between
from residua.decide.window import empty_window, moving_sum
from residua.errors import DataError, SettingError

#: What makes a test of the whitening matrix that belongs to it.
MakeTest = Callable[[NDArray[np.float64]], MatchedTest]


def level_for_rate(test: MatchedTest, rate: float) -> float:
    r"""Return the level that the largest of all matched statistics exceeds in at most that fraction of the samples.

    Every hypothesis gives a standard normal number on white innovations, and neighbouring ones correlate. With a tree
    over the hypotheses, Hunter's inequality

    .. math::

       P\left(\bigcup_i A_i\right) \le \sum_i P(A_i) - \sum_{(i, j) \in \mathrm{tree}} P(A_i \cap A_j)

    is sharper than Bonferroni's, which lacks the second sum. Each arrival is linked to the next one of the same fault,
    or to the same one of an earlier fault, whichever correlates more. Where it is smaller, the chi-squared
    distribution of all numbers in the window together is used.

    Parameters
    ----------
    test : MatchedTest
    rate : float
        Per sample.

    Returns
    -------
    float

    References
    ----------
    Hunter (1976), Journal of Applied Probability 13(3), 597-603; Owen (1956) for pairs of normal numbers.
    """
    links, singles = _tree(test)
    low, high = 0.0, 40.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if _bound(middle, links, singles) <= rate else (middle, high)
    from scipy.special import chdtri  # slow to import, and needed only here

    numbers = len(test.settled) * (len(test.responses) or 1)
    return min(high, float(np.sqrt(chdtri(numbers, rate))))


def _bound(level: float, links: NDArray[np.float64], singles: int) -> float:
    """Return Hunter's bound on the probability that any hypothesis is over the level, to either side."""
    from scipy.special import ndtr, owens_t

    tail = float(ndtr(-level))
    same, opposite = (owens_t(level, np.sqrt((1 - r) / np.maximum(1 + r, 1e-300))) for r in (links, -links))
    return 2 * tail * singles + float(np.sum(np.maximum(4 * (same + opposite) - 2 * tail, 0.0)))


def _tree(test: MatchedTest) -> tuple[NDArray[np.float64], int]:
    """Return the correlations along a tree over all hypotheses, and the number of those without a link."""
    links: list[float] = []
    rho, settled = test.responses, test.settled
    size = np.sqrt(test.weights)
    products = np.zeros((len(test.faults),) * 2)
    steady = np.linalg.norm(settled, axis=0)
    following = np.sum(np.cumsum(rho[:-1] * rho[1:], axis=0), axis=1) if len(rho) else np.zeros((0, 0))
    singles = 0

    def link(j: int, row: NDArray, sizes: NDArray, extra: float) -> int:
        """Link hypothesis ``j`` to the one that it resembles most, of ``extra`` and those of earlier faults."""
        others = np.abs(row[:j]) / np.where(sizes[:j] > 0, sizes[:j], np.inf) / sizes[j]
        found = max(float(others.max(initial=0.0)), extra)
        if found > 0:
            links.append(min(found, 1.0))
        return int(found <= 0)

    for k in range(len(rho)):
        products += rho[k].T @ rho[k]
        for j in np.flatnonzero(size[k] > 0):
            before = size[k - 1, j] if k else 0.0
            own = abs(following[k - 1, j]) / before / size[k, j] if before > 0 else 0.0
            singles += link(int(j), products[j], size[k], own)
    total = rho.sum(axis=0) if len(rho) else np.zeros_like(settled)
    for j in np.flatnonzero(steady > 0):
        own = 0.0
        if len(rho) and size[-1, j] > 0:
            own = abs(float(total[:, j] @ settled[:, j])) / (size[-1, j] * steady[j] * np.sqrt(test.samples))
        singles += link(int(j), settled[:, j] @ settled, steady, own)
    return np.array(links), singles


def matched_test_from_model(
    settings: NormThreshold, covariance: NDArray | None, n_residuals: int, make: MakeTest
) -> NormTest | None:
    """Return whitening and threshold that need no data, or ``None`` when data are needed."""
    _check_settings(settings)
    base = norm_test_from_model(settings, covariance, n_residuals)
    if base is None or settings.threshold is not None:
        return base
    level = level_for_rate(make(base.whitening), settings.false_alarm_rate)
    basis = (
        f"bound on the largest of all hypotheses at {settings.false_alarm_rate:g} per sample, noise model of the plant"
    )
    return replace(base, threshold=level, basis=basis)


def fit_matched_test(
    settings: NormThreshold,
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    make: MakeTest,
    *,
    false_alarm_rate: float,
    covariance: NDArray | None,
    signal_size: float,
    seams: Sequence[int] = (),
) -> NormTest:
    """Fit mean, covariance and threshold to fault-free residuals, as :func:`fit_norm_test` does.

    The threshold is the smallest for which the fraction of usable samples in alarm is at most ``false_alarm_rate``,
    extended by the tail of the data where fewer than ten samples would be left in alarm.
    """
    _check_settings(settings)
    base = fit_norm_test(
        settings,
        residuals,
        usable,
        false_alarm_rate=false_alarm_rate,
        covariance=covariance,
        signal_size=signal_size,
        seams=seams,
    )
    if np.sqrt(np.sum(np.var(residuals[usable], axis=0))) <= 1e-12 * signal_size:
        raise DataError("these data have no noise, and matched filters weigh a response against noise: add some")
    test = make(base.whitening)
    count = int(usable.sum())
    if count < 10 * test.samples:
        raise DataError(
            f"{count} usable samples are too few to fit matched filters over {test.samples} samples: give at least "
            f"{10 * test.samples} fault-free samples after the filter has settled"
        )
    if settings.threshold is not None:
        return base
    parts = parts_between(len(usable), seams)
    statistic = np.sqrt(np.concatenate([_largest(test, base, residuals[part], usable[part]) for part in parts]))
    fitted, basis = fitted_threshold(statistic, usable, base, false_alarm_rate, seams=seams)
    return replace(base, threshold=float(max(fitted, np.finfo(float).tiny)), basis=basis)


def _largest(test: MatchedTest, base: NormTest, residuals: NDArray, usable: NDArray[np.bool_]) -> NDArray:
    """Return the largest likelihood ratio at every sample of one recording."""
    centred = np.where(usable[:, None], residuals - base.center, 0.0)
    q = (centred @ base.whitening)[None]
    sums, _ = moving_sum(summed(q, usable[None]), empty_window(1, test.samples, q.shape[2] + 2))
    found, _ = match_block(test, empty_match(test, 1), q, usable[None], sums)
    return found["ratios"][0].max(axis=1)


def _check_settings(settings: NormThreshold) -> None:
    if settings.window != 1:
        raise SettingError(
            f"NormThreshold(window={settings.window}) has no meaning for matched filters, whose window is that of "
            "their responses: leave it at 1"
        )
