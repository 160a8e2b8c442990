"""Some runs of a campaign: simulated, watched, and reduced to a few numbers each.

Every run draws from seeds of its own, and everything is computed run by run or in a fixed order of sums, so that the
numbers do not depend on how runs are put together.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.alarm import put_down_to
from residua.decide.isolation import Scores, Seen, last_over
from residua.decide.test import Block, Tested
from residua.design import ResidualGenerator
from residua.linear import StateSpace
from residua.monitor.fused import run_block
from residua.monitor.plant_records import rows_of
from residua.monitor.running import filter_block, initial_state
from residua.monitor.specification import FilterState, Specification
from residua.robust.sets.uncertain_plant import UncertainPlant
from residua.validate.noise import NoiseModel, Resampled
from residua.validate.scenario import Case, channel_of
from residua.validate.truth import ActingFault, Truth, truth_of, with_acting_fault

#: Codes of names that are not groups: no alarm was raised; nobody was named; several faults at once.
NO_ALARM, UNKNOWN, SEVERAL = -1, -2, -3
#: Numbers in the arrays of runs that are simulated together, about: bounds memory.
_NUMBERS = 10_000_000
#: Streams of one run.
_NOISE, _DISTURBANCE, _MEMBER, _FAULT = range(4)


@dataclass(frozen=True, eq=False)
class Plan:
    """Parameters of all runs, besides their numbers.

    Attributes
    ----------
    spec : Specification
    generator : ResidualGenerator
        Sampled.
    truths : tuple of Truth
        Simulated in turn; empty where each run has a member of its own.
    uncertain : UncertainPlant or None
    controller : StateSpace or None
    cases : tuple of Case
    samples : int
    seed : int
    inputs : ndarray, shape (samples, inputs)
        Deviations.
    disturbances : ndarray, shape (samples, disturbances)
    drawn : tuple of (int, NoiseModel)
        Disturbances that each run draws.
    noise : NoiseModel, Resampled or None
    within : int
        Samples after an onset in which a detection counts.
    offset : ndarray, shape (channels,)
        Operating point of the simulated plant.
    """

    spec: Specification
    generator: ResidualGenerator
    truths: tuple[Truth, ...]
    uncertain: UncertainPlant | None
    controller: StateSpace | None
    cases: tuple[Case, ...]
    samples: int
    seed: int
    inputs: NDArray[np.float64]
    disturbances: NDArray[np.float64]
    drawn: tuple[tuple[int, NoiseModel], ...]
    noise: NoiseModel | Resampled | None
    within: int
    offset: NDArray[np.float64]

    @property
    def runs_at_once(self) -> int:
        """Number of runs to simulate together."""
        spec = self.spec
        width = 4 * spec.B.shape[1] + 6 * len(spec.C) + len(spec.isolation.groups) + 2 * len(spec.members) + 8
        return max(1, min(1024, _NUMBERS // (2 * self.samples * width) + 1))

    @property
    def at_once(self) -> bool:
        """True if the whole of a run is watched at once: for matched filters."""
        return self.spec.test.responses is not None

    def first_sample(self, case: Case) -> int:
        """Return the sample from which a case is watched, where its fault may begin."""
        if self.at_once:
            return 0
        return case.shape.earliest_sample(self.generator.dt)

    def stream(self, run: int, *of: int) -> np.random.Generator:
        """Return the random generator of a run, independent of all other draws."""
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(run, *of)))


@dataclass(frozen=True, eq=False)
class RunFigures:
    """Figures of each run; samples are counted from the first of a run.

    Attributes
    ----------
    decided, alarmed, raised : ndarray of int, shape (runs,)
        Without a fault: samples with a decision, those in alarm, and alarms raised.
    onset, stop : ndarray of int, shape (cases, runs)
        Sample of the onset, and the one up to which a detection counts.
    detected : ndarray of int, shape (cases, runs)
        First sample in alarm from the onset on; -1 without one.
    named : ndarray of int, shape (cases, runs)
        Number of the group that the isolation puts first at the last sample over the threshold, or ``NO_ALARM``,
        ``UNKNOWN``, ``SEVERAL``. The word of a diagnosis is not looked for: it takes longer than the rest of a run.
    peak, quiet_peak : ndarray, shape (cases, runs)
        Largest statistic over these samples, with and without the fault; minus infinity without a decision.
    by_chance : ndarray of bool, shape (cases, runs)
        True if the run without the fault is in alarm in these samples.
    """

    decided: NDArray[np.int32]
    alarmed: NDArray[np.int32]
    raised: NDArray[np.int32]
    onset: NDArray[np.int32]
    stop: NDArray[np.int32]
    detected: NDArray[np.int32]
    named: NDArray[np.int32]
    peak: NDArray[np.float64]
    quiet_peak: NDArray[np.float64]
    by_chance: NDArray[np.bool_]

    @property
    def runs(self) -> int:
        """Number of runs."""
        return self.decided.shape[-1]

    def put(self, at: int, part: RunFigures) -> None:
        """Write the figures of consecutive runs into their places."""
        for one in fields(self):
            getattr(self, one.name)[..., at : at + part.runs] = getattr(part, one.name)

    def first(self, runs: int) -> RunFigures:
        """Return the figures of the first runs."""
        return RunFigures(**{one.name: getattr(self, one.name)[..., :runs] for one in fields(self)})

    @classmethod
    def empty(cls, cases: int, runs: int) -> RunFigures:
        """Return figures to be filled."""
        return cls(
            **{name: np.zeros(runs, dtype=np.int32) for name in ("decided", "alarmed", "raised")},
            **{name: np.full((cases, runs), -1, dtype=np.int32) for name in ("onset", "stop", "detected", "named")},
            **{name: np.full((cases, runs), -np.inf) for name in ("peak", "quiet_peak")},
            by_chance=np.zeros((cases, runs), dtype=bool),
        )


@dataclass(frozen=True, eq=False)
class _Simulated:
    """Some runs without a fault: their plants, inputs of the simulation, recorded signals, and resampled residuals."""

    truths: list[Truth]
    z: NDArray[np.float64]
    signals: NDArray[np.float64]
    residuals: NDArray[np.float64] | None


@dataclass(frozen=True, eq=False)
class _Watched:
    """A stretch of some runs: residuals, results of the test, of matched filters scores, and the later states."""

    block: Block
    tested: Tested
    scores: Scores | None
    filter: FilterState
    test: Any


class _Quiet:
    """Some runs without a fault, watched piece by piece: a case continues where its fault may begin, bit for bit."""

    def __init__(self, plan: Plan, first: int, last: int) -> None:
        self.plan, self.runs = plan, last - first
        self.simulated = _simulated(plan, first, last)
        self.cuts = sorted({0, plan.samples, *(plan.first_sample(case) for case in plan.cases)})
        start = initial_state(plan.spec, self.runs)
        self.states: dict[int, tuple[FilterState, Any]] = {0: (start.filter, start.test)}
        self.pieces: list[_Watched] = []
        for a, b in pairwise(self.cuts):
            piece = watch(plan, self.simulated.signals[:, a:b], self.residuals(a, b), self.states[a], a)
            self.pieces.append(piece)
            self.states[b] = (piece.filter, piece.test)
        self.isolated: dict[int, Any] = {0: plan.spec.isolation.start(self.runs)}

    def residuals(self, a: int, b: int) -> NDArray[np.float64] | None:
        """Return resampled residuals from one sample up to another."""
        return None if self.simulated.residuals is None else self.simulated.residuals[:, a:b]

    def of(self, name: str) -> NDArray[Any]:
        """Return a result of the test for all samples."""
        return np.concatenate([getattr(piece.tested, name) for piece in self.pieces], axis=1)

    def isolation_state(self, cut: int) -> Any:
        """Return the state of the isolation after all samples before one of the cuts."""
        if cut not in self.isolated:
            k = self.cuts.index(cut) - 1
            before, piece = self.isolation_state(self.cuts[k]), self.pieces[k]
            self.isolated[cut] = self.plan.spec.isolation.run(before, piece.block, piece.tested)[0]
        return self.isolated[cut]


def figures_of(plan: Plan, first: int, last: int) -> RunFigures:
    """Return the figures of the runs from ``first`` up to ``last``."""
    quiet = _Quiet(plan, first, last)
    out = RunFigures.empty(len(plan.cases), last - first)
    alarm, usable, statistic = (quiet.of(name) for name in ("alarm", "usable", "statistic"))
    out.decided[:] = np.count_nonzero(usable, axis=1)
    out.alarmed[:] = np.count_nonzero(alarm & usable, axis=1)
    out.raised[:] = alarm[:, 0] + np.count_nonzero(alarm[:, 1:] & ~alarm[:, :-1], axis=1)
    for number, case in enumerate(plan.cases):
        _one_case(plan, number, case, first, quiet, out)
        for k in range(last - first):
            a, b = int(out.onset[number, k]), int(out.stop[number, k])
            out.quiet_peak[number, k] = np.fmax.reduce(statistic[k, a:b], initial=-np.inf)
            out.by_chance[number, k] = alarm[k, a:b].any()
    return out


def quiet_statistics(plan: Plan, first: int, last: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the statistic of some runs without a fault, and the mask of decisions, both (runs, samples)."""
    quiet = _Quiet(plan, first, last)
    return quiet.of("statistic"), quiet.of("usable")


def _simulated(plan: Plan, first: int, last: int) -> _Simulated:
    """Return runs without a fault."""
    if plan.uncertain is None:
        truths = [plan.truths[run % len(plan.truths)] for run in range(first, last)]
        truths = truths[:1] if len(plan.truths) == 1 else truths
    else:
        members = [plan.uncertain.sample(plan.stream(run, _MEMBER), 1)[0] for run in range(first, last)]
        truths = [truth_of(member, plan.generator.dt, plan.controller, plan.samples) for member in members]
    one = truths[0]
    m, q = one.inputs, one.disturbances
    z = np.zeros((last - first, plan.samples, one.B.shape[1]))
    z[:, :, :m], z[:, :, m : m + q] = plan.inputs, plan.disturbances
    for k, run in enumerate(range(first, last)):
        if isinstance(plan.noise, NoiseModel) and one.noises:
            z[k, :, m + q :] = plan.noise.draw(plan.stream(run, _NOISE), plan.samples, one.noises)
        for column, model in plan.drawn:
            z[k, :, m + column] += model.draw(plan.stream(run, _DISTURBANCE, column), plan.samples, 1)[:, 0]
    if len(truths) == 1:
        signals = one.respond(z)
    else:
        signals = np.concatenate([truth.respond(z[k : k + 1]) for k, truth in enumerate(truths)])
    residuals = None
    if isinstance(plan.noise, Resampled):
        rows = [plan.noise.draw(plan.stream(run, _NOISE), plan.samples) for run in range(first, last)]
        residuals = np.stack(rows)
    return _Simulated(truths, z, signals, residuals)


def watch(
    plan: Plan,
    signals: NDArray[np.float64],
    resampled: NDArray[np.float64] | None,
    state: tuple[FilterState, Any],
    count: int,
) -> _Watched:
    """Return the results of the test on recorded signals (deviations), from a state after ``count`` samples on."""
    spec = plan.spec
    data = signals + plan.offset
    if plan.at_once and resampled is None:  # in parts where outputs are missing: memory
        whole, decisions = run_block(spec, initial_state(spec, len(data)), data)
        block = Block(decisions.residuals, decisions.usable)
        return _Watched(block, decisions.tested, decisions.named, whole.filter, whole.test)
    after, filtered = filter_block(spec, state[0], data)
    residuals = filtered.residuals if resampled is None else filtered.residuals + resampled
    block = Block(residuals, filtered.usable, count, filtered.bends, filtered.signals)
    test, tested = spec.test.run(state[1], block)
    return _Watched(block, tested, None, after, test)


def _one_case(plan: Plan, number: int, case: Case, first: int, quiet: _Quiet, out: RunFigures) -> None:
    """Fill in the figures of one case."""
    runs, cut = quiet.runs, plan.first_sample(case)
    alike = not case.shape.differs
    drawn = [
        case.shape.over(plan.samples, plan.generator.dt, plan.stream(first + k, _FAULT, case.scenario))
        for k in range(1 if alike else runs)
    ]
    onsets = np.array([onset for onset, _ in drawn] * (runs if alike else 1), dtype=np.int64)
    stops = np.minimum(onsets + plan.within, plan.samples)
    end = int(stops.max())
    share = np.stack([course for _, course in drawn])
    signals = _with_fault(plan, case, quiet.simulated, onsets, share, slice(cut, end))
    seen = watch(plan, signals, quiet.residuals(cut, end), quiet.states[cut], cut)
    out.onset[number], out.stop[number] = onsets, stops
    for k in range(runs):
        a, b = int(onsets[k]) - cut, int(stops[k]) - cut
        alarm = seen.tested.alarm[k, a:b]
        at = int(alarm.argmax())
        if alarm[at]:
            out.detected[number, k] = onsets[k] + at
        out.peak[number, k] = np.fmax.reduce(seen.tested.statistic[k, a:b], initial=-np.inf)
    out.named[number] = _names(plan, quiet, seen, out.detected[number], stops, cut)


def _with_fault(
    plan: Plan,
    case: Case,
    simulated: _Simulated,
    onsets: NDArray[np.int64],
    share: NDArray[np.float64],
    part: slice,
) -> NDArray[np.float64]:
    """Return a part of the recorded signals with a fault; ``share`` has one row for all runs, or one for each."""
    truths = simulated.truths
    fault = truths[0].faults.index(case.fault)
    if case.shape.acts != "adds":
        kind, i = channel_of(case.fault, plan.generator.plant)
        channel = i if kind == "u" else truths[0].inputs + i
        acting = ActingFault(case.shape, case.size, fault, channel)  # pyright: ignore[reportArgumentType]
        every = np.broadcast_to(share, (len(simulated.signals), share.shape[1]))
        return with_acting_fault(truths, acting, simulated.z, simulated.signals, onsets, every)[:, part]
    course, signals = case.size * share[:, part], simulated.signals[:, part]  # there is nothing before
    if len(truths) == 1:
        return signals + truths[0].respond_to_fault(fault, course)
    rows = [course[k % len(course)][None] for k in range(len(truths))]
    parts = [truth.respond_to_fault(fault, row) for truth, row in zip(truths, rows, strict=True)]
    return signals + np.concatenate(parts)


def _names(
    plan: Plan, quiet: _Quiet, seen: _Watched, detected: NDArray[np.int32], stops: NDArray[np.int64], cut: int
) -> NDArray[np.int64]:
    """Return the group named in each run: by the longest alarm from the onset on."""
    out = np.full(len(detected), NO_ALARM, dtype=np.int64)
    who = np.flatnonzero(detected >= 0)
    out[who] = UNKNOWN
    spec = plan.spec
    if not who.size or not spec.isolation.groups:
        return out
    block, tested, scores = seen.block, seen.tested, seen.scores
    if scores is None:
        scores = spec.isolation.run(quiet.isolation_state(cut), block, tested)[1]
        tested = replace(tested, likelihood=None)
    time = np.asarray(plan.generator.dt * np.arange(cut, cut + block.usable.shape[1]), dtype=np.float64)
    number = {group: g for g, group in enumerate(spec.isolation.groups)}
    for k in who.tolist():
        one = rows_of(tested, k)
        shown = Seen(time, block.residuals[k], one, rows_of(scores, k), plan.generator, spec.test, None, cut)
        start, stop = _longest_alarm(one.alarm, int(detected[k]) - cut, int(stops[k]) - cut)
        named = spec.isolation.name(shown, start, stop, last_over(one.exceeded, start, stop))
        faults = put_down_to(named.reading, named.candidates)
        if len(faults) > 1:
            out[k] = SEVERAL
        elif faults:
            blamed = named.reading is not None
            if not blamed:  # not an unlisted fault, or none
                best, others = named.candidates[0], max(named.unknown or 0.0, named.no_fault or 0.0)
                blamed = np.isfinite(best.score) and (best.probability is None or best.probability >= others)
            out[k] = number.get(tuple(faults[0]), UNKNOWN) if blamed else UNKNOWN
    return out


def _longest_alarm(alarm: NDArray[np.bool_], first: int, stop: int) -> tuple[int, int]:
    """Return the longest alarm of one run between two samples, the later of two of equal length.

    One that stood before is returned from where it was raised.
    """
    edges = first + np.flatnonzero(np.diff(np.concatenate([[0], alarm[first:stop].astype(np.int8), [0]])))
    pairs = edges.reshape(-1, 2)
    longest = len(pairs) - 1 - int(np.argmax((pairs[:, 1] - pairs[:, 0])[::-1]))
    start, end = pairs[longest].tolist()
    before = np.flatnonzero(~alarm[:start])
    return (int(before[-1]) + 1 if before.size else 0) if start == first else start, end
