"""Thresholds of matched filters: a bound on the false alarm rate over all hypotheses, or fitted to data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import check_rate, rate_aimed_at
from residua.decide.false_alarms import observed, promise_of
from residua.decide.fault_free import FaultFree, Moments
from residua.decide.isolation import check_groups
from residua.decide.matched_recursion import MatchedTest, MatchState, empty_match, match_block, summed
from residua.decide.persistence import AlarmRuns
from residua.decide.test import Block, FaultFreeRun, ResidualTest, Tested, TestSettings, Watched
from residua.decide.whitened_norm import (
    NormSettings,
    NormTest,
    against_threshold,
    fit_moments,
    norm_test_from_model,
    whitened_residuals,
)
from residua.decide.window import WindowState, empty_window, moving_sum
from residua.design import ResidualGenerator
from residua.errors import DataError, FileFormatError, SettingError
from residua.records import joined, table_in
from residua.tolerances import SIGNAL_ROUNDING, TINY
from residua.visible import echo
from residua.words import one_in

#: Function from a whitening matrix to its test.
MakeTest = Callable[[NDArray[np.float64]], MatchedTest]


@dataclass(frozen=True, eq=False)
class Likelihoods:
    """Likelihood ratio, arrival and size of every fault at every sample, as of :class:`residua.decide.Match`.

    Attributes
    ----------
    values : dict of str to ndarray
        ``ratios``, ``ages``, ``sizes``, ``deviations`` and ``settled_sizes``.
    sums : ndarray, shape (plants, time, residuals + 2)
        Of the whitened residual, its square and the usable mask, over the window.
    """

    values: dict[str, NDArray]
    sums: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LikelihoodState:
    """State of the test of likelihoods.

    Attributes
    ----------
    window : WindowState
    match : MatchState
    runs : AlarmRuns
    """

    window: WindowState
    match: MatchState
    runs: AlarmRuns


@dataclass(frozen=True, eq=False)
class LikelihoodTest(NormTest):
    """Fitted test of the root of the largest likelihood ratio over faults and arrivals.

    Attributes
    ----------
    matched : MatchedTest
        The responses.
    """

    matched: MatchedTest = field(kw_only=True)

    def start(self, plants: int) -> LikelihoodState:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return the state before the first sample."""
        window = empty_window(plants, self.matched.samples, self.whitening.shape[1] + 2)
        match = empty_match(self.matched, plants, bends=True)
        return LikelihoodState(window, match, AlarmRuns.empty(plants))

    def run(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, state: LikelihoodState, block: Block
    ) -> tuple[LikelihoodState, Tested]:
        """Compare the root of the largest likelihood ratio with the threshold."""
        q, usable = whitened_residuals(self.center, self.whitening, block)
        sums, window = moving_sum(summed(q, usable), state.window)
        likelihoods, match = match_block(self.matched, state.match, q, usable, sums, block.bends)
        statistic = np.where(usable, np.sqrt(likelihoods["ratios"].max(axis=2)), np.nan)
        runs, tested = against_threshold(self, state.runs, statistic, usable, q)
        return LikelihoodState(window, match, runs), replace(tested, likelihood=Likelihoods(likelihoods, sums))

    @property
    def responses(self) -> MatchedTest:
        """The responses."""
        return self.matched

    @property
    def mean_time(self) -> None:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Unknown: the statistic is the largest of many ratios."""
        return None

    def words(self, step: float) -> dict[str, str]:
        """Describe the threshold, the statistic, and the start and end of an alarm."""
        window = self.matched.window
        statistic = f"largest standardised size of a step fault that arrived up to {window} samples ago, or before"
        if not len(self.matched.responses):
            statistic = f"largest standardised size of a settled fault, over {window + 1} samples"
        return super().words(step) | {"test": statistic}

    # --------------------------------------------------------------------------- files

    def check(self, watched: Watched) -> None:
        """Raise if a test from a file does not fit the watched generator."""
        super().check(watched)
        where, test, faults = "fitted.matched", self.matched, watched.generator.faults
        check_groups(test.groups, test.unjudged, where, faults)
        if test.faults != faults:
            raise FileFormatError(f"{where}: faults must be those of the plant")
        rows = len(test.responses) if len(test.responses) == 0 else test.samples
        expected = (rows, watched.generator.n_residuals, len(faults))
        for name, array, shape in (("responses", test.responses, expected), ("settled", test.settled, expected[1:])):
            if array.shape != shape:
                raise FileFormatError(f"{where}.{name} must be finite numbers of shape {shape}")
        for group in test.groups:  # a fault without a response cannot be found
            columns = [faults.index(name) for name in group]
            if not (test.responses[..., columns].any() or test.settled[:, columns].any()):
                raise FileFormatError(f"{where}.responses: those of {echo(group[0])} must not all be zero")

    def check_state(self, state: LikelihoodState) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Raise if a state from a file is invalid."""
        state.window.check("state.test.window")


@dataclass(frozen=True, eq=False)
class LikelihoodThreshold(TestSettings):
    """Test of likelihoods made from a threshold on a norm for matched filters; users set the parts of it.

    Attributes
    ----------
    settings : NormSettings
    window : int
    steady : bool
    make : callable
        From a generator to a function from a whitening matrix to responses.
    """

    kind: ClassVar[str] = "likelihood"
    makes: ClassVar[type[ResidualTest]] = LikelihoodTest

    settings: NormSettings
    window: int
    steady: bool
    make: Callable[[ResidualGenerator], MakeTest]

    @property
    def false_alarm_rate(self) -> float | None:  # pyright: ignore[reportIncompatibleVariableOverride]
        """False alarm rate of the settings."""
        return self.settings.false_alarm_rate

    @property
    def remedy(self) -> str:
        """Remedy for a missing threshold."""
        return self.settings.remedy

    def check(self, watched: Watched) -> None:
        """Raise if the settings do not suit the watched generator, or have no meaning for likelihoods."""
        settings = self.settings
        settings.check(watched)
        if settings.source != "auto":
            raise SettingError(f"source={settings.source!r} has no meaning for matched filters: leave it at 'auto'")
        if settings.window != 1:
            raise SettingError(
                f"NormThreshold(window={settings.window}) has no meaning for matched filters, whose window is that of "
                "their responses: leave it at 1"
            )

    def kept(self, watched: Watched) -> tuple[str, int, int] | None:
        """Return the window of the settings."""
        return self.settings.kept(watched)

    def from_model(self, watched: Watched) -> LikelihoodTest | None:
        """Return the test that needs no data; ``None`` when data are needed."""
        generator, settings = watched.generator, self.settings
        norm = norm_test_from_model(settings, generator.covariance_of_sums(1), generator.n_residuals)
        if norm is None:
            return None
        test = _of_likelihoods(norm, self.make(generator))
        if settings.threshold is not None:
            return test
        rate = rate_aimed_at(settings.false_alarm_rate)
        basis = f"bound on the largest of all hypotheses at {one_in(rate)} samples, noise model of the plant"
        return replace(test, threshold=level_for_rate(test.matched, rate), basis=basis)

    def fitted(self, watched: Watched, run: FaultFreeRun, rate: float) -> LikelihoodTest:
        """Return the test with mean, covariance and threshold fitted to fault-free data, for a rate of false alarms.

        The statistic of each stretch of time is that of the responses whitened by the covariance of the others.
        """
        check_rate(rate)
        settings, residuals, usable = self.settings, run.residuals, run.usable
        make = self.make(watched.generator)
        norm = fit_moments(
            replace(settings, threshold=settings.threshold or 1.0),  # that of the norm does not apply here
            residuals,
            usable,
            covariance=watched.generator.covariance_of_sums(1),
            signal_size=run.signal_size(),
            seams=run.seams,
        ).test
        if np.sqrt(np.sum(np.var(residuals[usable], axis=0))) <= SIGNAL_ROUNDING * run.signal_size():
            raise DataError("these data have no noise, and matched filters weigh a response against noise: add some")
        test, count = _of_likelihoods(norm, make), int(usable.sum())
        samples = test.matched.samples
        if count < 10 * samples:
            raise DataError(
                f"{count} usable samples are too few to fit matched filters over {samples} samples: give at least "
                f"{10 * samples} fault-free samples after the filter has settled"
            )
        if settings.threshold is not None:
            return test
        data, whole = FaultFree(residuals, usable, 1, run.seams), Moments(test.center, test.whitening)
        own = np.concatenate([_statistic(test.matched, whole, data, part) for part in data.parts])
        statistic = own.copy()
        for held, kept, summed_ in data.held_out():  # cross-fitted, by moments of samples that are far
            if test.shrinkage is None:  # the covariance is that of the noise model
                moments, responses = data.moments(kept, summed_, whitening=whole.whitening), test.matched
            else:
                moments = data.scaled(data.moments(kept, summed_), whole)
                responses = make(moments.whitening)
            for part in data.parts:
                inside = np.flatnonzero(held[part])
                if len(inside):
                    first, last = part.start + int(inside[0]), part.start + int(inside[-1]) + 1
                    begin = max(part.start, first - samples)  # earlier samples matter that long
                    values = _statistic(responses, moments, data, slice(begin, last))
                    statistic[first:last] = values[first - begin :]
        behind = np.concatenate([np.cumsum(usable[part]) for part in data.parts])
        seen = observed(
            statistic, usable & (behind >= samples), usable, data.parts, 1,
            persistence=test.persistence, release=test.release, window=samples, own=own,
        )  # fmt: skip
        promise = promise_of(seen, rate)
        basis = f"fitted to {count} fault-free samples, {promise}"
        threshold = float(max(promise.threshold, np.finfo(float).tiny))
        return replace(test, threshold=threshold, basis=basis, promised=float(promise.promised))

    def check_record(self, content: Mapping[str, Any], where: str) -> None:
        """Raise if a record of a test does not match these settings, before anything is built from it."""
        self.settings.check_record(content, where)
        matched, at = table_in(content.get("matched"), joined(where, "matched")), joined(where, "matched")
        if matched.get("window") != self.window:
            raise FileFormatError(f"{at}.window must be that of isolate, {self.window}")
        shape = table_in(matched.get("responses"), joined(at, "responses")).get("shape")
        rows = shape[0] if isinstance(shape, list) and shape else None
        if rows != (0 if self.steady else self.window + 1):
            raise FileFormatError(f"{at}.responses must be those of {self.window + 1} samples")


def level_for_rate(test: MatchedTest, rate: float) -> float:
    r"""Return the level that the largest matched statistic exceeds in at most a given fraction of the samples.

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
    """Return Hunter's bound on the probability that any hypothesis exceeds the level, on either side."""
    from scipy.special import ndtr, owens_t

    tail = float(ndtr(-level))
    same, opposite = (owens_t(level, np.sqrt((1 - r) / np.maximum(1 + r, TINY))) for r in (links, -links))
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
        """Link hypothesis ``j`` to its nearest one, among ``extra`` and those of earlier faults."""
        others = np.abs(row[:j]) / np.where(sizes[:j] > 0, sizes[:j], np.inf) / sizes[j]
        distance = max(float(others.max(initial=0.0)), extra)
        if distance > 0:
            links.append(min(distance, 1.0))
        return int(distance <= 0)

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


def _of_likelihoods(norm: NormTest, make: MakeTest) -> LikelihoodTest:
    """Return a test of likelihoods in place of a test of norms."""
    values = {one.name: getattr(norm, one.name) for one in fields(NormTest)}
    return LikelihoodTest(**values, matched=make(norm.whitening))


def _statistic(test: MatchedTest, moments: Moments, data: FaultFree, part: slice) -> NDArray[np.float64]:
    """Return the root of the largest likelihood ratio at every sample of a stretch of time."""
    usable = data.usable[part]
    centred = np.where(usable[:, None], data.residuals[part] - moments.center, 0.0)
    q = (centred @ moments.whitening)[None]
    sums, _ = moving_sum(summed(q, usable[None]), empty_window(1, test.samples, q.shape[2] + 2))
    likelihoods, _ = match_block(test, empty_match(test, 1), q, usable[None], sums)
    return np.sqrt(likelihoods["ratios"][0].max(axis=1))
