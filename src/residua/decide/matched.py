"""Isolation by matched filters: the fault and the arrival that explain the innovations best."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from residua.decide.alarm import Alarm, Candidate, Size
from residua.decide.checks import check_samples, is_number
from residua.decide.isolation import (
    Isolation,
    IsolationSettings,
    Named,
    Naming,
    Scores,
    Seen,
    by_cosine,
    last_over,
    leader,
    longest,
)
from residua.decide.matched_level import Likelihoods, LikelihoodThreshold
from residua.decide.matched_recursion import (
    HeldState,
    Match,
    MatchedTest,
    hold_block,
    match_after,
    match_block,
    no_match,
    summed,
)
from residua.decide.norm_threshold import NormThreshold
from residua.decide.sizes import fault_unit
from residua.decide.statement import Statement, scored, statement_by_score
from residua.decide.test import Block, ResidualTest, Tested, TestSettings, Watched
from residua.decide.whitened_norm import NormSettings
from residua.design import ResidualGenerator
from residua.design.banks.matched_filters import MatchedFilters, alike_faults, not_settled, step_responses
from residua.errors import FileFormatError, SettingError
from residua.linear.subspaces.whitening import whitening_matrix
from residua.linear.systems.recursion import ordered_product
from residua.number_kinds import SHARE, WINDOW, NumberKind
from residua.recording.clock import Clock
from residua.records import Record, record
from residua.visible import echo

#: Largest correlation between samples, relative, with which residuals still count as white.
_WHITE = 1e-6

#: Windows of samples of which likelihoods are computed at once: a window before them is computed for nothing.
_PIECE = 8

_MEANING = (
    "The score is the root of the fraction that a fault explains of what exceeds the noise in the window; sizes are "
    "those of a step whose arrival is known, with one standard deviation."
)


@dataclass(frozen=True, eq=False)
class MatchedNames(Isolation):
    """Fitted isolation by the likelihood of fault responses.

    Attributes
    ----------
    matched : MatchedTest
    """

    has_words: ClassVar[bool] = True

    matched: MatchedTest

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Groups of faults with similar responses."""
        return self.matched.groups

    @property
    def unjudged(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Faults without a response."""
        return self.matched.unjudged

    def start(self, plants: int) -> HeldState:
        """Return the state before the first sample."""
        return HeldState.empty(plants)

    def run(self, state: HeldState, block: Block, tested: Tested) -> tuple[HeldState, Scores]:
        """Return the attribution of a standing alarm, and the share of excess over noise that each group explains."""
        seen = tested.likelihood
        assert isinstance(seen, Likelihoods)
        likelihoods = seen.values
        match, state = hold_block(self.matched.window, state, likelihoods, tested.alarm, tested.exceeded, block.count)
        return state, Scores(match_scores(self.matched, likelihoods["ratios"], seen.sums, tested.usable), match=match)

    def name(self, seen: Seen, start: int, stop: int, last: int) -> Named:
        """Return the attribution of an alarm at its end, with arrival and onset if known."""
        match, time, step = seen.scores.match, seen.time, seen.generator.dt
        assert match is not None
        at = int(match.source[stop - 1])
        sources = sources_of(match, seen.tested.alarm & seen.tested.exceeded, start, at)

        def clock(number: int) -> float:
            return float(time[number]) if 0 <= number < len(time) else float(time[0] + number * step)

        candidates = self._ranked(seen, at, max(at, last), sources, clock)
        sizes = tuple(size for candidate in candidates for size in candidate.sizes)
        arrival = candidates[0].arrival
        return Named(candidates=candidates, sizes=sizes, arrival=arrival, onset=arrival)

    def name_now(self, seen: Seen) -> Named:
        """Return the candidates of the latest sample, and the fault and arrival that explain the alarm."""
        match, step = seen.scores.match, seen.generator.dt
        assert match is not None
        ago = seen.count - float(match.arrival[0])
        now = np.zeros(len(self.matched.faults), dtype=np.int64)
        settled = ago > self.matched.window
        candidates = self._ranked(seen, 0, 0, now, lambda number: (seen.count + number) * step, settled=settled)
        return Named(
            candidates=candidates,
            arrived=ago * step if np.isfinite(ago) else None,
            blamed=self.matched.faults[int(match.fault[0])],
        )

    def _ranked(
        self,
        seen: Seen,
        at: int,
        last: int,
        sources: NDArray[np.int64],
        clock: Callable[[int], float],
        *,
        settled: bool = False,
    ) -> tuple[Candidate, ...]:
        """Return the groups ranked by their likelihood, each with the arrival and size of its faults.

        Parameters
        ----------
        seen : Seen
        at : int
            The sample of the attribution.
        last : int
            That sample or a later one, of which the last sizes are. Where its window holds nothing of that of ``at``,
            it is new evidence, and the likelihoods of the two are added: it tells a fault that grows, or another one
            that follows, from the step that the beginning looked like.
        sources : ndarray of int, shape (faults,)
            For each fault the sample at which its arrival and size are taken; see :func:`sources_of`.
        clock : callable
            From the number of a sample to seconds.
        settled : bool
            Whether the last sizes are by the steady responses; always so where ``last`` is not ``at``.
        """
        test, match, plant = self.matched, seen.scores.match, seen.generator.plant
        assert match is not None
        ratios, shown = match.ratios[at], at
        if last - at > test.window:
            ratios = ratios + match.ratios[last]
            shown = max(at, last, key=lambda k: match.ratios[k].max())
        ends = match.settled_sizes[last] if settled or last != at else match.sizes[last]
        sizes = [
            Size(
                fault,
                float(match.sizes[sources[j], j]),
                float(ends[j]),
                fault_unit(plant, fault),
                float(match.deviations[sources[j], j]),
            )
            for j, fault in enumerate(test.faults)
        ]
        out = []
        for g, columns in enumerate(test.columns):
            best = max(columns, key=lambda j: ratios[j])
            age, score = int(match.ages[sources[best], best]), float(seen.scores.scores[shown, g])
            arrival = clock(int(sources[best]) - age) if age >= 0 else None
            of_group = tuple(sizes[j] for j in columns)
            out.append(by_cosine(test.groups[g], score, sizes=of_group, arrival=arrival, ratio=float(ratios[best])))
        return tuple(sorted(out, key=lambda c: -(c.ratio or 0.0)))

    def name_of_several(self, parts: Sequence[Alarm], exceeded: NDArray[np.bool_], name: Naming) -> Named:
        """Return the attribution of several alarms that are one.

        That of the longest part whose arrival is known, and not after the first part was raised; without any, of the
        longest of those in which the fault had arrived before the window. A later part may date the same fault anew, by
        what there is in its own window.
        """
        first, last = parts[0], parts[-1]
        dated = [part for part in parts if part.arrival is not None and part.arrival <= first.raised]
        who = longest(dated or [part for part in parts if part.arrival is None])
        named = name(first.start, who.stop, last_over(exceeded, last.start, last.stop))
        if named.candidates[0].faults == leader(first):
            return named
        return name(first.start, who.stop, last_over(exceeded, who.start, who.stop))  # the name that all parts agree on

    # ----------------------------------------------- interface to the rest of a monitor

    @property
    def samples(self) -> int:
        """Number of samples over which responses are matched."""
        return self.matched.samples

    def samples_to_be_sure(self, test: ResidualTest) -> int:
        """Return one: names are equally reliable after any time."""
        return 1

    @property
    def signatures(self) -> tuple[NDArray[np.float64], ...]:
        """Steady directions of the first fault of each group, without a column if it vanishes."""
        directions = [self.matched.settled[:, [columns[0]]] for columns in self.matched.columns]
        return tuple(d / np.linalg.norm(d) if d.any() else d[:, :0] for d in directions)

    def words(self, step: float) -> dict[str, str]:
        """Describe the naming of faults."""
        window = self.matched.window
        if not len(self.matched.responses):
            return {
                "isolation": "the settled response that explains them best; the name may be wrong until it has settled"
            }
        return {
            "isolation": f"the fault and arrival, up to {window} samples ({window * step:g} s) ago, that explain the "
            "innovations best; held once that arrival has left the window"
        }

    def statement(self, alarm: Alarm, clock: Clock, window: int) -> Statement:
        """Return the statement about an alarm: the lead of the likelihood, and the arrival of the fault."""
        arrived = "It arrived before the window of the matched filters, or grew slowly."
        if alarm.arrival is not None:
            arrived = f"Estimated arrival {clock.at(alarm.arrival)}, as a step."
        statement = statement_by_score(alarm, clock, self.word(alarm, window), meaning=_MEANING)
        return replace(statement, sentences=(*statement.sentences, arrived)) if scored(alarm) else statement

    @property
    def where_missing(self) -> str:
        """Text on the role of missing values."""
        return "samples without a decision count for none" if len(self.matched.responses) else ""

    def notes(self) -> tuple[str, ...]:
        """Return a warning if the window is shorter than the settling time of the responses."""
        test = self.matched
        late = [test.faults[j] for j in not_settled(test.responses, test.settled)] if len(test.responses) else []
        if not late:
            return ()
        return (
            f"the window of {test.window} samples is shorter than the responses to {', '.join(late)} take to settle: "
            "arrivals and sizes are the estimates while the arrival lay within the window; a longer window is better",
        )

    # --------------------------------------------------------------------------- files

    def check_state(self, state: HeldState, count: int) -> None:
        """Raise if a state from a file is invalid."""
        state.check("state.isolation.held", len(self.matched.faults), self.matched.window, count)

    def to_record(self) -> dict[str, Any]:
        """Return an empty record: the test has the responses."""
        return {}


@dataclass(frozen=True, eq=False)
class BesideState(Record):
    """State of an isolation by responses beside a test of another kind; a row per plant.

    Attributes
    ----------
    rows : ndarray, shape (plants, window, residuals)
        The last whitened residuals, zero where not usable.
    usable : ndarray of bool, shape (plants, window)
    held : HeldState
    """

    rows: NDArray[np.float64]
    usable: NDArray[np.bool_]
    held: HeldState


@dataclass(frozen=True, eq=False)
class NamesBeside(MatchedNames):
    """Names by responses beside a test of another kind: likelihoods of samples in alarm only.

    Outside alarms the last samples are kept, and nothing is computed: scores are NaN there, and likelihood ratios zero.
    Where outputs are missing and a Kalman filter goes on without them, the responses stay those of the whole filter.

    Attributes
    ----------
    scale : ndarray, shape (residuals, residuals), or None
        Whitening of the residual of the test, if the test itself does not whiten; see :func:`scale_beside`.
    """

    scale: NDArray[np.float64] | None = None

    def start(self, plants: int) -> BesideState:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return the state before the first sample."""
        kept = (plants, self.matched.window)
        rows = np.zeros((*kept, len(self.matched.settled)))
        return BesideState(rows, np.zeros(kept, dtype=bool), HeldState.empty(plants))

    def run(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, state: BesideState, block: Block, tested: Tested
    ) -> tuple[BesideState, Scores]:
        """Return the attribution of a standing alarm, and the share of excess over noise that each group explains."""
        window, (plants, time) = self.matched.window, tested.usable.shape
        q = tested.whitened if self.scale is None else ordered_product(tested.whitened, self.scale)
        q = np.where(tested.usable[..., None], q, 0.0)
        rows, usable = np.concatenate([state.rows, q], axis=1), np.concatenate([state.usable, tested.usable], axis=1)
        scores = np.full((plants, time, len(self.groups)), np.nan)
        match, held = no_match(plants, time, len(self.matched.faults)), state.held
        length = _PIECE * self.matched.samples if tested.alarm.any() else max(1, time)
        for begin in range(0, time, length):
            alarm = tested.alarm[:, begin : begin + length]
            who, columns = np.flatnonzero(alarm.any(axis=1)), np.flatnonzero(alarm.any(axis=0))
            before, held = held, HeldState.empty(plants)
            if not len(who):
                continue
            first, stop = begin + int(columns[0]), begin + int(columns[-1]) + 1
            seen = slice(first, stop + window)  # of rows, which begin a window before the block
            likelihoods = likelihoods_of(self.matched, rows[who, seen], usable[who, seen])
            own = HeldState(before.held[who], before.on[who]) if first == begin else HeldState.empty(len(who))
            alarm, exceeded = tested.alarm[who, first:stop], tested.exceeded[who, first:stop]
            # the sample that raises an alarm is taken for over the threshold, whatever a test of a user's own says
            raised = alarm & ~np.concatenate([own.on[:, None], alarm[:, :-1]], axis=1)
            count = np.broadcast_to(block.count, plants)[who] + first
            part, own = hold_block(window, own, likelihoods.values, alarm, exceeded | raised, count)
            here = np.ix_(who, np.arange(first, stop))
            values = match_scores(self.matched, part.ratios, likelihoods.sums, tested.usable[here])
            scores[here] = np.where(alarm[..., None], values, np.nan)
            for one in fields(Match):
                whole, value = getattr(match, one.name), getattr(part, one.name)
                whole[here] = np.where(alarm.reshape(*alarm.shape, *[1] * (value.ndim - 2)), value, whole[here])
            if stop == min(begin + length, time):
                held.held[who], held.on[who] = own.held, own.on
        return BesideState(rows[:, time:].copy(), usable[:, time:].copy(), held), Scores(scores, match=match)

    @property
    def signatures(self) -> tuple[NDArray[np.float64], ...]:
        """Steady directions of faults, in the units of the test."""
        if self.scale is None:
            return super().signatures
        turned = [np.asarray(np.linalg.solve(self.scale.T, one), dtype=float) for one in super().signatures]
        return tuple(one / float(np.linalg.norm(one)) if one.size else one for one in turned)

    def check_state(self, state: BesideState, count: int) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Raise if a state from a file is invalid."""
        if state.rows[~state.usable].any():
            raise FileFormatError("state.isolation.rows must be zero where no sample is usable")
        super().check_state(state.held, count)


def likelihoods_of(test: MatchedTest, q: NDArray[np.float64], usable: NDArray[np.bool_]) -> Likelihoods:
    """Return the likelihoods of all samples but the first ``window``, from these samples alone.

    Products and sums over the window are added in the order of time, from its first sample on: the bits are those of
    any earlier beginning.

    Parameters
    ----------
    test : MatchedTest
    q : ndarray, shape (plants, time, residuals)
        Whitened residuals, zero where not usable.
    usable : ndarray of bool, shape (plants, time)
    """
    window, values = test.window, summed(q, usable)
    sums = np.zeros_like(values[:, window:])
    for age in range(test.samples):
        sums += values[:, age : age + sums.shape[1]]
    state = match_after(test, q[:, :window], usable[:, :window])
    found, _ = match_block(test, state, q[:, window:], usable[:, window:], sums)
    return Likelihoods(found, sums)


def scale_beside(generator: ResidualGenerator, test: ResidualTest) -> NDArray[np.float64] | None:
    """Return a whitening of a test's residual by the noise of the plant; ``None`` if the test whitens already."""
    covariance = generator.covariance
    if test.per_deviation is not None or covariance is None:
        return None
    return whitening_matrix(test.metric.T @ covariance @ test.metric)


@dataclass(frozen=True)
class Matched(IsolationSettings):
    r"""Find the fault, its arrival and its size whose expected response resembles the innovations most.

    For each fault and each arrival up to ``window`` samples ago, and for each fault once it has settled, the
    generalised likelihood ratio against no fault; see :func:`residua.design.matched_filters` for the equations. The
    monitor's statistic is the square root of the largest: how many standard deviations the best size is from zero.
    Its threshold bounds the fraction of fault-free samples over it by Hunter's inequality over all hypotheses, or is
    fitted to fault-free data. So it is for the design :func:`residua.design.matched_filters`, and for a Kalman filter
    beside :class:`residua.decide.NormThreshold`.

    Beside any other test (:class:`residua.decide.MultiscaleEWMA`, which a Kalman filter has by default, ``CUSUM``, one
    of a user's own) statistic and alarm are those of that test, and only the names are by responses: likelihoods are
    computed of samples in alarm, and scores are NaN at all others. They take the responses of the whole filter, also
    while outputs are missing and a Kalman filter goes on without them.

    Parameters
    ----------
    window : int
        Arrival times ``t - window`` to ``t`` are distinguished.
    steady : bool
        Only the settled response of each fault, averaged over ``window + 1`` samples: no arrival times, and wrong
        names while the residual turns.
    alike : float
        Faults whose responses correlate by that much or more are one group.

    References
    ----------
    Gertler (1991), section 5.3; Willsky and Jones (1976), IEEE TAC 21(1), 108-112.
    """

    kind: ClassVar[str] = "matched"
    makes: ClassVar[type[Isolation]] = MatchedNames
    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {"window": WINDOW, "alike": SHARE}

    window: int = 40
    steady: bool = False
    alike: float = 0.999

    def __post_init__(self) -> None:
        """Check the settings."""
        check_samples(self.window, "window")
        object.__setattr__(self, "window", int(self.window))
        if not isinstance(self.steady, (bool, np.bool_)):
            raise SettingError(f"steady must be True or False, got {echo(self.steady)}")
        object.__setattr__(self, "steady", bool(self.steady))
        if not is_number(self.alike) or not 0 < self.alike <= 1:
            raise SettingError(f"alike must be a correlation, over 0 and up to 1, got {echo(self.alike)}")
        object.__setattr__(self, "alike", float(self.alike))

    def isolation(self, generator: ResidualGenerator, test: ResidualTest) -> MatchedNames:
        """Return the isolation by the responses of the test, or beside it by responses under the same whitening."""
        if test.responses is not None:
            return MatchedNames(test.responses)
        scale = scale_beside(generator, test)
        return NamesBeside(self._maker(generator)(test.metric if scale is None else test.metric @ scale), scale)

    # ----------------------------------------------- interface to the rest of a monitor

    @classmethod
    def for_design(cls, design: Any, generator: ResidualGenerator) -> Self | None:
        """Return the window and grouping of matched filters; ``None`` for other designs."""
        return cls(design.window, design.steady, design.alike) if isinstance(design, MatchedFilters) else None

    def check(self, generator: ResidualGenerator) -> None:
        """Raise unless the residuals are innovations: white, so that products with responses can simply be added."""
        advice = "design with matched_filters or kalman_filter, on the sampled plant, plant.discretize(dt)"
        if not generator.faults:
            raise SettingError("Matched looks for the responses to faults, and this plant has none")
        covariance = generator.covariance
        if covariance is None:
            raise SettingError(
                f"Matched needs white residuals of known covariance, and this generator has none: {advice}"
            )
        spread = np.sqrt(np.diag(covariance))
        for window in (2, 10):
            sums = generator.covariance_of_sums(window)
            assert sums is not None  # as for one sample
            off = np.abs(sums - covariance) / np.outer(spread, spread)
            if not off.max(initial=0.0) <= _WHITE:
                raise SettingError(
                    f"Matched needs white residuals, and those of this generator ({generator.method}) correlate over "
                    f"time ({off.max():.2g}): {advice}"
                )

    def own_test(self, design: Any) -> TestSettings | None:
        """Return a threshold on the norm for matched filters, which becomes one on likelihoods; else ``None``."""
        return NormThreshold() if isinstance(design, MatchedFilters) else None

    def test_of(self, settings: TestSettings) -> TestSettings:
        """Return the test of likelihoods with the threshold, persistence and release of a norm; any other unchanged."""
        if settings.divides:
            raise SettingError(
                "groups are for residuals that are named by direction or not at all; here faults are matched: leave "
                "groups out, or isolate=Directional() or None"
            )
        if not isinstance(settings, NormSettings):
            return settings
        return LikelihoodThreshold(settings, self.window, self.steady, self._maker)

    def _maker(self, generator: ResidualGenerator) -> Callable[[NDArray[np.float64]], MatchedTest]:
        """Return a function from a whitening matrix to responses, which are simulated once."""
        responses, settled = step_responses(generator, self.window)
        return lambda whitening: matched_test(self, generator.faults, responses, settled, whitening)

    def kept(self, generator: ResidualGenerator) -> tuple[str, int, int] | None:
        """Return the window, and the number of values it keeps: residuals, and their products with all responses."""
        k = generator.n_residuals
        values = k + 2 + (0 if self.steady else len(generator.faults) * (k + 2))
        return f"Matched(window={self.window})", self.window + 1, values

    def isolation_from_record(self, content: Any, where: str, watched: Watched, test: ResidualTest) -> Isolation:
        """Build the isolation from the test's responses alone; the record is empty."""
        record(content, where, ())
        return self.isolation(watched.generator, test)


def matched_test(
    settings: Matched,
    faults: tuple[str, ...],
    responses: NDArray[np.float64],
    settled: NDArray[np.float64],
    whitening: NDArray[np.float64],
) -> MatchedTest:
    """Return the test of whitened residuals, with similar faults grouped.

    Parameters
    ----------
    settings : Matched
    faults : tuple of str
    responses, settled : ndarray
        As :func:`residua.design.banks.matched_filters.step_responses` returns them, before whitening.
    whitening : ndarray, shape (residuals, residuals)
    """
    white = np.einsum("kmf,mr->krf", responses, whitening)
    steady = whitening.T @ settled
    alike = alike_faults(steady[None] if settings.steady else white, settings.alike)
    groups = tuple(tuple(faults[j] for j in group) for group in alike)
    judged = {name for group in groups for name in group}
    return MatchedTest(
        settings.window,
        faults,
        groups,
        white[:0] if settings.steady else white,
        steady,
        tuple(name for name in faults if name not in judged),
    )


def match_scores(test: MatchedTest, ratios: NDArray, sums: NDArray, usable: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return for each group the share of the excess over noise in the window that its best response explains, or NaN.

    The root of the fraction of energy, so that it is a correlation where noise is small: 1 for the best one where
    nothing is left but what noise alone exceeds in one window of a thousand.
    """
    expected = sums[..., -1] * len(test.settled)
    excess = sums[..., -2] - expected - 3.0 * np.sqrt(2.0 * expected)
    best = np.stack([np.max(ratios[..., list(columns)], axis=-1) for columns in test.columns], axis=-1)
    whole = np.maximum(excess, best.max(axis=-1))
    judged = usable & (whole > 0)
    return np.where(judged[..., None], np.sqrt(best / np.where(judged, whole, 1.0)[..., None]), np.nan)


def sources_of(match: Match, judged: NDArray[np.bool_], raised: int, at: int) -> NDArray[np.int64]:
    """Return for each fault the last sample up to ``at`` at which it arrived no later than the alarm was raised.

    Without any, the last one at which it had arrived before the window. A fault cannot have arrived after its alarm.
    Later samples may yet date it so: once its true arrival has left the window, and where it has not settled, or never
    does, the best step is one that begins somewhere in the window.

    Parameters
    ----------
    match : Match
        Of one plant.
    judged : ndarray of bool, shape (time,)
        Samples in alarm and over the threshold.
    raised, at : int
    """
    now = np.arange(raised, at + 1)[:, None]
    ages = match.ages[raised : at + 1]
    over = judged[raised : at + 1, None]
    dated, settled = over & (ages >= 0) & (now - ages <= raised), over & (ages < 0)
    can = np.where(dated.any(axis=0), dated, settled)
    return np.where(can.any(axis=0), at - np.argmax(can[::-1], axis=0), raised)
