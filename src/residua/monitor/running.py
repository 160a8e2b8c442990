"""The arithmetic of a monitor: a pure function from state and data to state and decisions.

Everything here is vectorised over plants and gives the same bits however the time axis is cut.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.directional import DirectionTest
from residua.decide.matched import MatchedTest
from residua.decide.matched_hold import Match, joined_blocks
from residua.decide.member_thresholds import BankTest
from residua.decide.norm_threshold import NormTest
from residua.decide.residual_groups import GroupTest
from residua.decide.structured import CodeTest
from residua.decide.window import WindowState, empty_window, moving_sum
from residua.linear.systems.recursion import ordered_product
from residua.monitor.filtering import Filtered, filter_block
from residua.monitor.judging import alarms_since, empty_fields, judge_groups, judge_matched, judge_members, judge_whole
from residua.monitor.partial_update import PartialUpdate, empty_partial
from residua.monitor.starting import StartFit

#: Responses that are held at once, in numbers.
_MOST_NUMBERS = 10**7
#: Largest whitened residual that is judged: the square of a sum of many still is a number.
_LARGEST = 1e120


@dataclass(frozen=True, eq=False)
class Specification:
    """Everything that running needs and that never changes.

    Attributes
    ----------
    A, B, C, D : ndarray
        Of the sampled generator, driven by ``[u, y]`` as deviations.
    start : ndarray, shape (states, channels)
        Maps a sample to the filter state that it would settle to.
    offset : ndarray, shape (channels,)
        Operating point.
    test : NormTest or BankTest
        Of the residual as a whole, or of every member of a bank, or group of residuals, on its own.
    direction : DirectionTest or None
    codes : CodeTest or None
        For a bank whose members are tested one by one.
    matched : MatchedTest or None
        For innovations that are matched with the responses to the faults.
    settle : int
        Samples after a start, or after a held value, in which nothing is decided.
    max_hold : int
        Longest gap over which missing values are held; after a longer one the filter starts anew.
    plausible : ndarray, shape (channels, 2)
        Smallest and largest deviation of each channel from its operating point that is taken for a value; any other is
        missing.
    first : StartFit or None
        What estimates a start from the first residuals; ``None`` where a start is from rest.
    partial : PartialUpdate or None
        What a Kalman filter needs to go on where outputs are missing; ``None`` for any other generator.
    """

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]
    start: NDArray[np.float64]
    offset: NDArray[np.float64]
    test: NormTest | BankTest
    direction: DirectionTest | None
    codes: CodeTest | None
    matched: MatchedTest | None
    settle: int
    max_hold: int
    plausible: NDArray[np.float64]
    first: StartFit | None
    partial: PartialUpdate | None

    @property
    def judge(self) -> DirectionTest | CodeTest | MatchedTest | None:
        """What names the fault."""
        return self.direction or self.codes or self.matched

    @property
    def window(self) -> int:
        """Samples over which direction, code or response is judged."""
        if self.matched:
            return self.matched.samples
        judge = self.direction or self.codes
        return judge.window if judge else 1

    @property
    def judged(self) -> int:
        """How many numbers are summed over that window: the residuals, or the alarms of the members.

        With matched filters also the square of the residual, and whether it is usable.
        """
        return len(self.codes.members) if self.codes else len(self.C) + (2 if self.matched else 0)

    @property
    def alarms(self) -> tuple[int, ...]:
        """Shape of the alarms of one plant: one number, or one per member of a bank or group of residuals."""
        return (len(self.test.sizes),) if isinstance(self.test, BankTest) else ()

    @property
    def members(self) -> tuple[str, ...]:
        """Names of what has an alarm of its own: members of a bank, or groups of residuals."""
        if self.codes:
            return self.codes.members
        return self.test.names if isinstance(self.test, GroupTest) else ()


@dataclass(frozen=True, eq=False)
class State:
    """What a running monitor remembers; every array has one row per plant.

    Attributes
    ----------
    x : filter state; held : last value of each channel; gap : incomplete samples in a row;
    running : whether the filter has been started; age : samples since its start or the last held value;
    up, down : usable samples in a row over and under the threshold; alarm : whether it is on; since : samples seen
    when it was raised, that one included, 0 while it is off (each of these four with an axis for the members of a
    bank, whose ``since`` is when they first fired in the standing alarm of the bank); ends, block, begun, filled : of
    the moving sum for the direction, or of the members' alarms for the code
    (:class:`residua.decide.window.WindowState`), and the same with ``test_`` for the threshold test; count : samples
    so far; resets : restarts after long gaps; broken : restarts of a filter whose state overflowed;
    starting : whether the start is still to be estimated; start_sums : what residuals say of it so far; moved : how
    far that moved a residual, in units of the threshold, at most; apart : whether a Kalman filter is off its
    stationary one, since outputs were missing; spread : its covariance then, zero for the stationary one; bent : how
    far its errors by faults are off; match_sums, match_weights, match_held, match_extra : of the matched filters
    (:class:`residua.decide.matched.MatchState`).
    """

    x: NDArray[np.float64]
    held: NDArray[np.float64]
    gap: NDArray[np.int64]
    running: NDArray[np.bool_]
    age: NDArray[np.int64]
    up: NDArray[np.int64]
    down: NDArray[np.int64]
    alarm: NDArray[np.bool_]
    since: NDArray[np.int64]
    ends: NDArray[np.float64]
    block: NDArray[np.float64]
    begun: NDArray[np.float64]
    filled: int
    test_ends: NDArray[np.float64]
    test_block: NDArray[np.float64]
    test_begun: NDArray[np.float64]
    test_filled: int
    count: int
    resets: NDArray[np.int64]
    broken: NDArray[np.int64]
    starting: NDArray[np.bool_]
    start_sums: NDArray[np.float64]
    moved: NDArray[np.float64]
    apart: NDArray[np.bool_]
    spread: NDArray[np.float64]
    bent: NDArray[np.float64]
    match_sums: NDArray[np.float64]
    match_weights: NDArray[np.float64]
    match_held: NDArray[np.float64]
    match_extra: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Decisions:
    """What a monitor decided on a block; every array starts with (plants, time).

    Attributes
    ----------
    residuals, statistic, exceeded, alarm, up, usable, missing : ndarray
    scores : ndarray, shape (plants, time, groups)
        Correlation with the signature of each group, or the fraction of the members of a bank that agree with its
        code; NaN where nothing can be said.
    member_statistics : ndarray, shape (plants, time, members)
        Statistic of each member of a bank, or group of residuals; ``statistic`` is then the largest ratio of one to its
        threshold.
    fired : ndarray of bool, shape (plants, time, members)
        Which members are in alarm.
    code : ndarray of bool, shape (plants, time, members)
        Which members count as fired over the window: what :func:`residua.decide.read_codes` reads. Of a dedicated bank
        with :class:`residua.decide.PeakThreshold`, which has a window of its own, those in alarm.
    aside : ndarray of bool, shape (plants, time, channels)
        Which values are not plausible, and were taken as missing.
    match : Match or None
        Of matched filters: likelihood ratio, arrival and size of every fault.
    """

    residuals: NDArray[np.float64]
    statistic: NDArray[np.float64]
    exceeded: NDArray[np.bool_]
    alarm: NDArray[np.bool_]
    up: NDArray[np.int64]
    usable: NDArray[np.bool_]
    missing: NDArray[np.bool_]
    scores: NDArray[np.float64]
    member_statistics: NDArray[np.float64]
    fired: NDArray[np.bool_]
    code: NDArray[np.bool_]
    aside: NDArray[np.bool_]
    match: Match | None = None


def initial_state(spec: Specification, plants: int) -> State:
    """Return the state before the first sample."""
    n, m, k = len(spec.A), spec.B.shape[1], spec.test.whitening.shape[1]
    whole, flag = np.zeros(plants, dtype=np.int64), np.zeros(plants, dtype=bool)
    runs, alarm = np.zeros((plants, *spec.alarms), dtype=np.int64), np.zeros((plants, *spec.alarms), dtype=bool)
    judged, tested = empty_window(plants, spec.window, spec.judged), empty_window(plants, spec.test.window, k)
    return State(
        x=np.zeros((plants, n)),
        held=np.zeros((plants, m)),
        gap=whole,
        running=flag,
        age=whole,
        up=runs,
        down=runs,
        alarm=alarm,
        since=runs,
        **_window_fields(judged, ""),
        **_window_fields(tested, "test_"),
        count=0,
        resets=whole,
        broken=whole,
        starting=flag,
        start_sums=np.zeros((plants, 0 if spec.first is None else n)),
        moved=np.zeros(plants),
        apart=flag,
        **empty_partial(spec.partial, plants),
        **empty_fields(spec.matched, plants, spec.partial is not None),
    )


def run_block(spec: Specification, state: State, data: NDArray[np.float64]) -> tuple[State, Decisions]:
    """Run filter, test and isolation over a block of samples.

    Parameters
    ----------
    spec : Specification
    state : State
    data : ndarray, shape (plants, time, channels)
        Control inputs, then outputs, in plant units; NaN or infinity where a value is missing.

    Returns
    -------
    state : State
        To go on with.
    decisions : Decisions
    """
    step = _longest_block(spec, state, data)
    if step >= data.shape[1]:
        return _run_at_once(spec, state, data)
    parts: list[Decisions] = []
    for start in range(0, data.shape[1], step):
        state, part = _run_at_once(spec, state, data[:, start : start + step])
        parts.append(part)
    return state, joined_decisions(parts)


def _run_at_once(spec: Specification, state: State, data: NDArray[np.float64]) -> tuple[State, Decisions]:
    changed, filtered = filter_block(spec, state, data)
    return _decide(spec, replace(state, **changed), filtered)


def _longest_block(spec: Specification, state: State, data: NDArray[np.float64]) -> int:
    """Return how many samples to run at once: matched filters hold the responses at each where outputs are missing."""
    if spec.matched is None or spec.partial is None or data.shape[1] < 2:
        return data.shape[1]
    low, high = (spec.plausible + spec.offset[:, None]).T
    if not state.apart.any() and ((data >= low) & (data <= high)).all():
        return data.shape[1]
    return max(1, _MOST_NUMBERS // max(1, state.bent.size))


def joined_decisions(parts: Sequence[Decisions]) -> Decisions:
    """Return the decisions on consecutive blocks as those on one."""
    names = [field.name for field in fields(Decisions) if field.name != "match"]
    joined = {name: np.concatenate([getattr(part, name) for part in parts], axis=1) for name in names}
    matches = [part.match for part in parts if part.match is not None]
    return Decisions(**joined, match=joined_blocks(matches) if matches else None)


# ------------------------------------------------------------------- decisions


def _decide(spec: Specification, state: State, filtered: Filtered) -> tuple[State, Decisions]:
    test = spec.test
    time = filtered.residuals.shape[1]
    q, usable = _whitened(test, filtered)
    test_window = WindowState(state.test_ends, state.test_block, state.test_begun, state.test_filled)
    tested, test_window = moving_sum(q, test_window)
    window = WindowState(state.ends, state.block, state.begun, state.filled)
    further: dict[str, NDArray] = {}
    if isinstance(test, GroupTest):
        all_of_it = ordered_product(np.where(usable[..., None], filtered.residuals - test.center, 0.0), test.whole)
        decide = judge_groups(test, spec.direction, state, all_of_it, tested, window, usable)
    elif isinstance(test, BankTest):
        assert spec.codes is not None
        decide = judge_members(test, spec.codes, state, tested, window, usable)
    elif spec.matched is not None:
        decide, further = judge_matched(test, spec.matched, state, q, window, usable, filtered.bends)
    else:
        decide = judge_whole(test, spec.direction, state, q, tested, window, usable)
    (alarm, up, down), window, found = decide
    if time:
        state = replace(
            state,
            up=up[:, -1].copy(),
            down=down[:, -1].copy(),
            alarm=alarm[:, -1].copy(),
            since=alarms_since(alarm, state),
            **_window_fields(window, ""),
            **_window_fields(test_window, "test_"),
            **further,
            count=state.count + time,
        )
    return state, Decisions(
        residuals=filtered.residuals, usable=usable, missing=filtered.missing, aside=filtered.aside, **found
    )


def _whitened(test: NormTest | BankTest, filtered: Filtered) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return whitened residuals, zero where not usable, and what is usable: nothing that would overflow a sum."""
    usable = filtered.usable
    with np.errstate(over="ignore", invalid="ignore"):
        centred = np.where(usable[..., None], filtered.residuals - test.center, 0.0)
    q = ordered_product(centred, test.whitening)
    if q.size and not (q.min() >= -_LARGEST and q.max() <= _LARGEST):
        fits = np.asarray((np.abs(q) <= _LARGEST).all(axis=2))
        q, usable = np.where(fits[..., None], q, 0.0), usable & fits
    return q, usable


def _window_fields(window: WindowState, prefix: str) -> dict[str, Any]:
    """Return the fields of a monitor's state that hold a window."""
    return {prefix + name: getattr(window, name) for name in ("ends", "block", "begun", "filled")}
