"""Isolation by likelihood: the probability of each fault, and faults that the data cannot distinguish."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.alarm import Alarm
from residua.decide.autoregression import Past, unforetold
from residua.decide.checks import PRIOR_RATE, check_samples, is_number
from residua.decide.directional import Directional, direction_test
from residua.decide.isolation import Isolation, IsolationSettings, Named, Scores, Seen, by_cosine, check_groups
from residua.decide.multiscale_ewma import MultiscaleEWMA
from residua.decide.sizes import with_sizes
from residua.decide.statement import Statement, not_isolated, scored, statement_by_word
from residua.decide.stream_settings import StreamSettings
from residua.decide.stream_test import StreamTest
from residua.decide.test import Block, ResidualTest, Tested, TestSettings, Watched
from residua.decide.whitened_norm import whitened_residuals
from residua.decide.word import ANYTHING, EITHER, GOOD, POOR, TOO_EARLY, Word
from residua.design import ResidualGenerator
from residua.errors import FileFormatError, SettingError
from residua.linear.subspaces.whitening import VARIANCE_FLOOR
from residua.linear.systems.recursion import ordered_product
from residua.number_kinds import ENTRY, FLAG, MAX_WINDOW, POSITIVE, PROBABILITY, NumberKind
from residua.recording.clock import Clock
from residua.visible import echo
from residua.words import number

#: A p-value from which on faults are called not distinguishable, and below which one does not explain a residual.
LEVEL = 0.05
#: A p-value below which no listed fault explains the residual.
_RARE = 0.001
#: Combinations of residuals of which less variance than that is left, of whitened ones, move too little for a model.
_STILL = VARIANCE_FLOOR**0.5
#: Logarithm of a probability that counts as none: a number that files hold, and that one sample makes up for.
_NEVER = -10_000.0
_AGES = NumberKind(f"a whole number from 2 to {MAX_WINDOW}", "i", lambda n: (n >= 2) & (n <= MAX_WINDOW))
_LASTING = NumberKind("a finite number above 1", "f", lambda x: np.isfinite(x) & (x > 1))
_RULES = (
    "The probabilities are those of a filter over the faults, their arrivals and sizes, with the prior rates and the "
    f"mean duration that were set. p is the probability of a residual at least as far off its fault by noise alone; "
    f"faults whose p against the first one is {LEVEL:g} or more, and which are not {1 / LEVEL:g} times less probable, "
    "are called not distinguishable here. Good match: any other fault, listed or not, is "
    f"{1 / LEVEL:g} times less probable, none is below {LEVEL:g}, and p is not. Either: others are within reach. Poor "
    f"match: one that is not listed is more probable, or p is below {_RARE:g}. Too early: none is {LEVEL:g} or more."
)


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
        """Return the belief after one sample."""
        roots, constants = self._roots_and_constants

        def evidence(sums: NDArray[np.float64], ages: slice) -> NDArray[np.float64]:
            """Return the logarithm of the likelihood ratio against no fault."""
            whitened = (sums[..., :, None] * roots[:, ages]).sum(axis=-2)
            return 0.5 * (whitened**2).sum(axis=-1) + constants[:, ages]

        none = belief.none[:, None, None]
        added = (self._by_age * e[:, None, None, :, None]).sum(axis=-2)
        before = np.zeros_like(belief.sums)
        before[:, :, 1:] = belief.sums[:, :, :-1]
        arrived = np.full_like(belief.ages, 0.0)
        arrived[:, :, :1] = none + np.log(self.rates)[:, None]
        goes_on = np.log1p(-1.0 / self.duration)
        arrived[:, :, 1:] = belief.ages[:, :, :-1] + goes_on
        sums = before + added
        ages = arrived + evidence(sums, slice(1, None)) - evidence(before, slice(None, -1))
        old = belief.sums[:, :, -1:] * (1.0 - 1.0 / self.window)
        last = old + added[:, :, -1:]
        stays = belief.ages[:, :, -1:] + goes_on
        stays = stays + evidence(last, slice(-1, None)) - evidence(old, slice(-2, -1))
        total = np.logaddexp(ages[:, :, -1:], stays)
        share = np.exp(stays - total)[..., None]
        sums[:, :, -1:] += share * (last - sums[:, :, -1:])
        ages[:, :, -1:] = total
        ended = _log_sum(belief.ages.reshape(len(e), -1)) - np.log(self.duration)
        quiet = np.logaddexp(belief.none + np.log1p(-self.rates.sum()), ended)
        whole = np.logaddexp(quiet, _log_sum(ages.reshape(len(e), -1)))
        return Belief(
            np.maximum(quiet - whole, _NEVER), np.maximum(ages - whole[:, None, None], _NEVER), np.asarray(sums)
        )

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
    def _roots_and_constants(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Root and logarithm of the determinant of the information on the size, at the ages 0, 1, ..., window."""
        H, one = self._by_age, np.eye(self.unknown.shape[-1])
        J = np.cumsum(np.einsum("gakd,gakc->gadc", H, H), axis=1)
        J = np.concatenate([np.zeros_like(J[:, :1]), J], axis=1)
        roots = np.linalg.cholesky(np.linalg.inv(J + one / self.size**2))
        return np.asarray(roots, dtype=float), np.asarray(-0.5 * np.linalg.slogdet(one + self.size**2 * J)[1])


def _log_sum(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the logarithm of the sum of the exponentials of each row."""
    most = rows.max(axis=1)
    return most + np.log(np.exp(rows - most[:, None]).sum(axis=1))


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior of each sample.

    Attributes
    ----------
    probability : ndarray, shape (..., groups + 2)
        Of each group, of an unknown fault, of none.
    white : ndarray, shape (..., m)
        The white residual, zero where not seen.
    """

    probability: NDArray[np.float64]
    white: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LikelihoodState:
    """State of the filter.

    Attributes
    ----------
    past : Past
    belief : Belief
    recent : ndarray, shape (plants, window, m + 1)
        The white residuals of the standing alarm, with a column that is 1 where one was seen.
    """

    past: Past
    belief: Belief
    recent: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LikelihoodNames(Isolation):
    """Fitted isolation by likelihoods of faults in white residuals.

    Attributes
    ----------
    groups, unjudged
        Faults whose directions are the same are one group.
    center, whitening, coefficients, rewhitening
        Of the test, as of ``CUSUMTest``.
    live : ndarray of bool, shape (k,)
        The whitened residuals that noise moves.
    directions : ndarray, shape (groups, k)
        Of length 1, in whitened residuals.
    rates : ndarray, shape (groups + 1,)
        Prior rates; last that of an unknown fault.
    duration, size : float
    window : int
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {
        "window": _AGES,
        "center": ENTRY,
        "whitening": ENTRY,
        "coefficients": ENTRY,
        "rewhitening": ENTRY,
        "live": FLAG,
        "directions": ENTRY,
        "rates": PROBABILITY,
        "duration": _LASTING,
        "size": POSITIVE,
    }

    groups: tuple[tuple[str, ...], ...]
    unjudged: tuple[str, ...]
    center: NDArray[np.float64]
    whitening: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    rewhitening: NDArray[np.float64]
    live: NDArray[np.bool_]
    directions: NDArray[np.float64]
    rates: NDArray[np.float64]
    duration: float
    size: float
    window: int

    @cached_property
    def filter(self) -> FaultFilter:
        """The filter over faults, with the step responses after the autoregression."""
        k, live = len(self.center), self.live
        sums = np.cumsum(np.concatenate([np.eye(k)[None], -self.coefficients]), axis=0)
        steps = (sums @ self.rewhitening)[:, :, live]
        responses = np.einsum("gk,akm->gam", self.directions, steps)
        return FaultFilter(responses, steps[:, live], self.rates, self.duration, self.size, self.window)

    @cached_property
    def lines(self) -> NDArray[np.float64]:
        """Directions of the white residual under settled faults: columns of length 1, shape (m, groups)."""
        settled = self.filter.responses[:, -1]
        return (settled / np.linalg.norm(settled, axis=1)[:, None]).T

    def start(self, plants: int) -> LikelihoodState:
        """Return the state before the first sample."""
        recent = np.zeros((plants, self.window, int(self.live.sum()) + 1))
        return LikelihoodState(Past.empty(plants, self.coefficients), self.filter.start(plants), recent)

    def run(self, state: LikelihoodState, block: Block, tested: Tested) -> tuple[LikelihoodState, Scores]:
        """Return the probabilities of the faults after each sample."""
        q, usable = whitened_residuals(self.center, self.whitening, block)
        e, seen, past = unforetold(self.coefficients, state.past, q, usable)
        e = ordered_product(e, self.rewhitening)[..., self.live]
        e = np.where(seen[..., None], e, 0.0)
        belief, probability = self.filter.run(state.belief, e, seen)
        probability = np.where(seen[..., None], probability, np.nan)
        flagged = np.concatenate([e, seen[..., None].astype(float)], axis=-1)
        recent = np.concatenate([state.recent, np.zeros_like(flagged)], axis=1)
        for plant in range(len(seen)):
            quiet = np.flatnonzero(~tested.alarm[plant])
            first = int(quiet[-1]) + 1 if quiet.size else 0
            if quiet.size:
                recent[plant] = 0.0
            recent[plant, self.window + first :] = flagged[plant, first:]
        after = LikelihoodState(past, belief, recent[:, seen.shape[1] :].copy())
        return after, Scores(probability[..., : len(self.groups)], posterior=Posterior(probability, e))

    # ------------------------------------------------------------------------- naming

    def name(self, seen: Seen, start: int, stop: int, last: int) -> Named:
        """Return the groups by their probability at the last sample over the threshold."""
        posterior, around = seen.scores.posterior, super().name(seen, start, stop, last)
        assert posterior is not None
        judged = slice(max(start, last - self.window + 1), last + 1)
        named = self._ranking(posterior.probability[last], posterior.white[judged][seen.tested.usable[judged]])
        candidates = with_sizes(named.candidates, around.sizes)
        return replace(named, candidates=candidates, sizes=around.sizes, fired=around.fired)

    def name_now(self, seen: Seen) -> Named:
        """Return the groups by their probability now."""
        posterior = seen.scores.posterior
        assert posterior is not None
        recent = seen.state.recent[0]
        return self._ranking(posterior.probability[0], recent[recent[:, -1] > 0, :-1])

    def _ranking(self, probability: NDArray[np.float64], rows: NDArray[np.float64]) -> Named:
        """Return the attribution from probabilities, and from the white residuals of an alarm."""
        if not self.groups or np.isnan(probability).any():
            return Named()
        order = len(self.coefficients)
        rows = rows[order:] if len(rows) > order else rows  # the first ones are not yet those of a settled step
        z = rows.sum(axis=0) / np.sqrt(max(len(rows), 1))
        length = float(np.linalg.norm(z))
        ranks = np.argsort(-probability[: len(self.groups)], kind="stable")
        best, candidates = self.lines[:, ranks[0]], []
        for g in ranks:
            line = self.lines[:, g]
            score = min(abs(float(line @ z)) / length, 1.0) if length > 0 else 0.0
            candidates.append(
                by_cosine(
                    self.groups[g],
                    score,
                    probability=float(probability[g]),
                    p_value=fit_p_value(z, line),
                    pair_p_value=None if g == ranks[0] else pair_p_value(z, line, best),
                )
            )
        return Named(candidates=tuple(candidates), unknown=float(probability[-2]), no_fault=float(probability[-1]))

    # ----------------------------------------------- interface to the rest of a monitor

    @property
    def samples(self) -> int:
        """Length of the window."""
        return self.window

    @property
    def signatures(self) -> tuple[NDArray[np.float64], ...]:
        """Directions in the residual as the test whitens it."""
        return tuple(row[:, None] for row in self.directions)

    def words(self, step: float) -> dict[str, str]:
        """Describe the naming of faults."""
        over = f"{self.window} samples ({self.window * step:g} s)"
        return {"isolation": f"probability of each fault, by the likelihood of steps, told apart by age up to {over}"}

    def statement(self, alarm: Alarm, clock: Clock, window: int) -> Statement:
        """Return the statement about an alarm: probabilities and p-values."""
        word, candidates = self.word(alarm, window), scored(alarm)
        if word is None:
            return not_isolated(alarm, clock)
        best = candidates[0]
        sure = best.probability or 0.0
        same = tuple(
            c
            for c in candidates[1:]  # the window may not tell them apart, and all that went before it may
            if (c.pair_p_value or 0.0) >= LEVEL and (c.probability or 0.0) >= LEVEL * sure
        )
        unknown, none = alarm.unknown or 0.0, alarm.no_fault or 0.0
        first = f"Probability {number(sure, 3)} of {best.name}, {number(unknown, 3)} of a fault that is not listed, "
        first += f"{number(none, 3)} of none."
        sentences, lines = [first], []
        if best.p_value is not None:
            verb = "explains" if best.p_value >= LEVEL else "does not explain"
            text = f"{best.name} alone {verb} the residual to within the noise (p = {number(best.p_value, 2)})"
            sentences.append(f"{text}.")
            lines += [text] if best.p_value < LEVEL else []
        for c in same:
            text = f"not distinguishable here: {best.name}, {c.name} (p = {number(c.pair_p_value or 0.0, 2)})"
            sentences.append(f"{text[:1].upper()}{text[1:]}.")
            lines.append(text)
        lines.append(f"probability {number(unknown, 3)} of a fault that is not listed, {number(none, 3)} of none")
        margin = sure - (candidates[1].probability or 0.0) if len(candidates) > 1 else None
        statement = statement_by_word(alarm, word, clock, sentences, _RULES, margin)
        return replace(statement, lines=(*statement.lines, *lines))

    def word(self, alarm: Alarm, window: int) -> Word | None:
        """Return the word for an alarm by the probabilities of the faults, of one that is not listed, and of none."""
        return word_by_probability(alarm)

    # --------------------------------------------------------------------------- files

    def check(self, watched: Watched, test: ResidualTest) -> None:
        """Raise if an isolation from a file does not match the residuals, the faults and the test."""
        where, k = "running.isolation", watched.generator.n_residuals
        check_groups(self.groups, self.unjudged, where, watched.generator.faults)
        for name in ("center", "whitening", "coefficients", "rewhitening"):
            if not isinstance(test, StreamTest) or not np.array_equal(getattr(self, name), getattr(test, name)):
                raise FileFormatError(f"{where}.{name} must be that of the test")
        if self.live.shape != (k,) or self.directions.shape != (len(self.groups), k):
            raise FileFormatError(
                f"{where}: live and directions must be for {k} residuals and {len(self.groups)} groups"
            )
        if self.rates.shape != (len(self.groups) + 1,) or not self.rates.sum() < 1:
            raise FileFormatError(f"{where}.rates must be {len(self.groups) + 1} numbers whose sum is below 1")
        if self.groups and not (self.live.any() and np.abs(self.filter.responses[:, -1]).max(axis=1).min() > 0):
            raise FileFormatError(f"{where}.directions: every group must move a residual that noise moves")

    def check_state(self, state: LikelihoodState, count: int) -> None:
        """Raise if a state from a file is invalid."""
        flags = state.recent[..., -1]
        if not np.isin(flags, (0.0, 1.0)).all():
            raise FileFormatError("state.isolation.recent: its last column must be 0 or 1")
        if (state.belief.ages > 0).any() or (state.belief.none > 0).any():
            raise FileFormatError("state.isolation.belief: logarithms of probabilities are not above 0")


def fit_p_value(z: NDArray[np.float64], line: NDArray[np.float64]) -> float | None:
    r"""Return the probability that noise alone leaves as much outside of a fault's direction.

    .. math:: |z|^2 - (\ell^T z)^2 \sim \chi^2_{m-1}

    ``None`` for one residual, beside which nothing is left.
    """
    from scipy.special import chdtrc

    if len(z) < 2:
        return None
    off_line = z - line * (line @ z)
    return float(chdtrc(len(z) - 1, off_line @ off_line))


def pair_p_value(z: NDArray[np.float64], line: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    r"""Return the probability that noise alone makes another fault explain as much beyond this one.

    .. math:: (n^T z)^2 \sim \chi^2_1, \qquad n \propto (I - \ell \ell^T) \ell'
    """
    from scipy.special import chdtrc

    n = other - line * (line @ other)
    return float(chdtrc(1, (n @ z) ** 2 / (n @ n)))


def word_by_probability(alarm: Alarm) -> Word | None:
    """Return the word for an alarm by the probabilities of its candidates; ``None`` without any."""
    candidates = scored(alarm)
    if not candidates:
        return None
    best, sure = candidates[0], candidates[0].probability or 0.0
    unknown, none = alarm.unknown or 0.0, alarm.no_fault or 0.0
    word = Word(GOOD, (best.faults,), why="by its probability", after=alarm.samples)
    if none >= max(LEVEL, unknown):
        return replace(word, kind=TOO_EARLY, why=f"the probability that there is no fault is {number(none, 2)}")
    if unknown > sure:
        return replace(word, kind=POOR, why=f"the probability of one that is not listed is {number(unknown, 2)}")
    if best.p_value is not None and best.p_value < _RARE:
        return replace(word, kind=POOR, why="no listed fault alone explains the residual to within the noise")
    close = tuple(c.faults for c in candidates if (c.probability or 0.0) >= LEVEL * sure)
    unlisted = unknown >= LEVEL * sure or (best.p_value is not None and best.p_value < LEVEL)
    if unlisted or len(close) > 1:
        return replace(word, kind=EITHER, faults=close, unlisted=ANYTHING if unlisted else "", why="")
    return word


@dataclass(frozen=True)
class Likelihood(IsolationSettings):
    r"""Report the probability of each fault, and the faults that the data cannot distinguish.

    The residual is made white by the test, so that a step of a fault of the direction :math:`\ell` is

    .. math:: e_t = \theta H_a + \nu_t, \qquad \nu_t \sim N(0, I), \qquad H_a \to h \ell

    at its age :math:`a`; :math:`H_a` is the response of the autoregression of the test to a step. A filter over the
    faults and their arrivals has the probability of each fault, of one that is not listed and of none; see
    :class:`residua.decide.likelihood.FaultFilter` for the equations. Over the alarm, :math:`z = \sum e / \sqrt n`,
    the generalised likelihood ratio of a fault against none is :math:`2 \ln \Lambda = (\ell^T z)^2`; the *p-value* of a
    fault is the probability that noise leaves as much of :math:`z` beside it, :math:`|z|^2 - (\ell^T z)^2 \sim
    \chi^2_{m-1}`, and that of a fault against the first one the probability that noise makes the first explain as much
    that this one does not, :math:`\chi^2_1`. Both hold whatever the size is.

    Guaranteed: of faults that are drawn from the prior rates, with sizes of N(0, size²) standard deviations, those of a
    probability p are right in a fraction p of cases. Assumes: a fault is a step, its direction is the steady one of the
    generator and is exact, one fault at a time, and a residual that the test makes white. A large fault of a direction
    that is slightly wrong is called one that is not listed.

    Parameters
    ----------
    window : int
        Ages of faults that are told apart, and samples of an alarm that the p-values are of. Time and memory grow with
        it, with the number of faults, and with the square of the number of residuals.
    prior_rates : float or mapping of str to float
        Probability with which a fault arrives in a sample: one for each fault, or by name; those without a name have
        the default.
    unknown_rate : float
        The same of a fault that is not listed.
    mean_duration : float
        Samples that a fault lasts, on average.
    size : float
        Standard deviation of the sizes of steps, in standard deviations of one sample of the residual along their
        direction.

    See Also
    --------
    residua.decide.Directional : Angles, for residuals of which no noise is known.
    residua.decide.Matched : Responses of innovations, with arrivals.

    References
    ----------
    Willsky and Jones (1976), IEEE TAC 21(1), 108-112 (likelihood ratios of steps of unknown size); Adams and MacKay
    (2007), arXiv:0710.3742, eqs. (3) and (4) (the filter over arrivals); Basseville and Nikiforov (1993), section 7.2.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> model = rs.Plant([[0.5, 0.1], [0.0, 0.6]], [[1.0], [0.5]], np.eye(2), dt=1.0)
    >>> model = model.with_sensor_faults().with_noise(process=0.1, measurement=1.0)
    >>> generator = rs.design.kalman_filter(model)
    >>> monitor = rs.Monitor(generator, test=rs.decide.CUSUM(), isolate=rs.decide.Likelihood(window=20))
    >>> rng = np.random.default_rng(0)
    >>> u = np.zeros((300, 1))
    >>> y = rng.standard_normal((300, 2))
    >>> y[150:, 0] += 4.0
    >>> best = monitor.run(u, y).alarms[0].candidates[0]
    >>> best.name, best.probability > 0.9
    ('y1 sensor', True)
    """

    kind: ClassVar[str] = "likelihood"
    makes: ClassVar[type[Isolation]] = LikelihoodNames
    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {
        "window": _AGES,
        "prior_rates": PROBABILITY,
        "unknown_rate": PROBABILITY,
        "mean_duration": _LASTING,
        "size": POSITIVE,
    }

    window: int = 30
    prior_rates: float | Mapping[str, float] = PRIOR_RATE
    unknown_rate: float = PRIOR_RATE
    mean_duration: float = 10_000.0
    size: float = 1.0

    def __post_init__(self) -> None:
        """Check the settings."""
        check_samples(self.window, "window", least=2)
        object.__setattr__(self, "window", int(self.window))
        rates = self.prior_rates
        if isinstance(rates, Mapping):
            by_name = {str(name): _rate(rate, f" of {echo(name)}") for name, rate in rates.items()}
            object.__setattr__(self, "prior_rates", by_name)
        else:
            object.__setattr__(self, "prior_rates", _rate(rates))
        _rate(self.unknown_rate, " of an unknown fault")
        object.__setattr__(self, "unknown_rate", float(self.unknown_rate))
        if not is_number(self.mean_duration) or not self.mean_duration > 1:
            raise SettingError(
                f"mean_duration is how many samples a fault lasts, and must be above 1, got {echo(self.mean_duration)}"
            )
        if not is_number(self.size) or not self.size > 0:
            raise SettingError(f"size must be a positive number of standard deviations, got {echo(self.size)}")
        for name in ("mean_duration", "size"):
            object.__setattr__(self, name, float(getattr(self, name)))

    def check(self, generator: ResidualGenerator) -> None:
        """Raise unless the generator has the faults of the prior rates, and directions."""
        rates = self.prior_rates if isinstance(self.prior_rates, dict) else {}
        strange = [name for name in rates if name not in generator.faults]
        if strange:
            raise SettingError(
                f"prior_rates has {', '.join(map(echo, strange))}, which this plant lacks: its faults are "
                f"{', '.join(generator.faults) or 'none'}"
            )
        whole = self.unknown_rate + sum(self.rate_of(name) for name in generator.faults)
        if whole >= 1:
            raise SettingError(f"the prior rates of all faults must be below 1 together, they are {whole:.3g}")

    def rate_of(self, fault: str) -> float:
        """Return the prior rate of one fault."""
        if isinstance(self.prior_rates, Mapping):
            return float(self.prior_rates.get(fault, PRIOR_RATE))
        return self.prior_rates

    def test_of(self, settings: TestSettings) -> TestSettings:
        """Return the test, if it is one that makes the residual white."""
        if not isinstance(settings, (StreamSettings, MultiscaleEWMA)):
            raise SettingError(
                f"Likelihood needs a residual without memory, which {type(settings).__name__} does not make: "
                "test=MultiscaleEWMA(), CUSUM(), GLR(), EWMA() or ChiSquared()"
            )
        return settings

    def isolation(self, generator: ResidualGenerator, test: ResidualTest) -> LikelihoodNames:
        """Return the isolation by the residual that the test makes white."""
        assert isinstance(test, StreamTest)
        live = moving(test)
        gain = test.steady_gain[:, live]
        # Directions are compared as they are judged: in the steady innovations under a fault.
        found = direction_test(
            Directional(1, "steady"), generator.subspaces, generator.steady_directions, test.whitening @ gain
        )
        groups = found.groups
        rows = [generator.steady_directions[group[0]] @ test.whitening for group in groups]
        rates = [sum(self.rate_of(name) for name in group) for group in groups]
        return LikelihoodNames(
            groups,
            found.unjudged,
            test.center,
            test.whitening,
            test.coefficients,
            test.rewhitening,
            live,
            np.array([row / np.linalg.norm(row) for row in rows]).reshape(len(groups), len(test.center)),
            np.array([*rates, self.unknown_rate]),
            self.mean_duration,
            self.size,
            self.window,
        )

    def kept(self, generator: ResidualGenerator) -> tuple[str, int, int] | None:
        """Return the window, and the number of values kept for each age: sums and probabilities of every fault."""
        k = generator.n_residuals
        return f"Likelihood(window={self.window})", self.window, (len(generator.faults) + 1) * (k + 1) + k + 1

    # --------------------------------------------------------------------------- files

    def check_record(self, content: Mapping[str, Any], where: str) -> None:
        """Raise if the window of the record differs from that of the settings."""
        if content.get("window") != self.window:
            raise FileFormatError(f"{where}.window must be that of isolate, {self.window}")


def _rate(rate: Any, of: str = "") -> float:
    """Return a prior rate, or raise."""
    if not is_number(rate) or not 0 < rate < 1:
        raise SettingError(
            f"the prior rate{of} is the probability with which a fault arrives in a sample, and must lie between 0 and "
            f"1, got {echo(rate)}"
        )
    return float(rate)


def moving(test: StreamTest) -> NDArray[np.bool_]:
    """Return the whitened residuals that noise moves; the others are copies, or rounding.

    Of less variance than a small part of the largest, before it was made one.
    """
    spread = 1.0 / np.sqrt(np.sum(np.linalg.pinv(test.whitening) ** 2, axis=0))
    sizes = np.sum((test.whitening / np.where(spread > 0, spread, 1.0)[:, None]) ** 2, axis=0)
    first = sizes * 2 * VARIANCE_FLOOR < sizes.min()
    again = np.sum(test.rewhitening**2, axis=0)
    return first & (again * _STILL < again[first].min(initial=np.inf))
