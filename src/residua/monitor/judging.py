"""From residuals to alarms and scores: as a whole, member by member, or matched with responses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.directional import DirectionTest
from residua.decide.matched import Bends, MatchedTest, MatchState, empty_match, match_block, match_scores, summed
from residua.decide.matched_hold import hold_block
from residua.decide.member_thresholds import BankTest, member_alarms
from residua.decide.norm_threshold import NormTest
from residua.decide.persistence import alarm_logic
from residua.decide.residual_groups import GroupTest
from residua.decide.row_norms import row_norms
from residua.decide.structured import CodeTest
from residua.decide.window import WindowState, moving_sum
from residua.linear.systems.recursion import ordered_product

if TYPE_CHECKING:
    from residua.monitor.running import State

_Judged = tuple[tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64]], WindowState, dict[str, Any]]


def judge_whole(
    test: NormTest,
    direction: DirectionTest | None,
    state: State,
    q: NDArray,
    tested: NDArray,
    window: WindowState,
    usable: NDArray[np.bool_],
) -> _Judged:
    """Return alarm, run lengths, window and decisions of a residual that is tested as a whole."""
    statistic = np.where(usable, row_norms(tested) / np.sqrt(test.window), np.nan)
    runs, found = _against_threshold(test, state, statistic, usable)
    sums, window = moving_sum(q, window)
    return runs, window, {**found, "scores": _scores(direction, sums, usable)}


def _against_threshold(
    test: NormTest, state: State, statistic: NDArray, usable: NDArray[np.bool_]
) -> tuple[tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64]], dict[str, Any]]:
    """Return alarm and run lengths of one statistic, and the decisions that follow from them alone."""
    exceeded = usable & (np.where(usable, statistic, 0.0) > test.threshold)
    alarm, up, down = alarm_logic(exceeded, usable, state.up, state.down, state.alarm, test.persistence, test.release)
    nobody = np.zeros((*usable.shape, 0))
    found = {
        "statistic": statistic,
        "exceeded": exceeded,
        "alarm": alarm,
        "up": up,
        "member_statistics": nobody,
        "fired": nobody.astype(bool),
        "code": nobody.astype(bool),
    }
    return (alarm, up, down), found


def judge_members(
    test: BankTest, codes: CodeTest, state: State, tested: NDArray, window: WindowState, usable: NDArray[np.bool_]
) -> _Judged:
    """Return alarms and run lengths of every member, window and decisions of a bank."""
    (fired, up, down), found = _one_by_one(test, state, tested, usable)
    alarm = found["alarm"]
    counts, window = moving_sum((fired & usable[..., None]).astype(float), window)  # whole numbers: exact
    largest = counts.max(axis=2, initial=0.0)[..., None]
    code = np.asarray(alarm)[..., None] & (counts > 0) & (counts >= codes.share * largest)
    if test.kind == "peak" and codes.dedicated:  # its window has passed already, and each member speaks for itself
        code = fired
    agree = np.zeros((*usable.shape, len(codes.groups)))
    for g in range(len(codes.groups)):
        agree[..., g] = np.count_nonzero(code == codes.codes[:, g], axis=2)
    read = usable & code.any(axis=2)
    scores = np.where(read[..., None], agree / len(codes.members), np.nan)
    return (fired, up, down), window, {**found, "scores": scores, "code": code}


def judge_groups(
    test: GroupTest,
    direction: DirectionTest | None,
    state: State,
    q: NDArray,
    tested: NDArray,
    window: WindowState,
    usable: NDArray[np.bool_],
) -> _Judged:
    """Return alarms and run lengths of every group of residuals, window and decisions; ``q`` is whitened as a whole."""
    runs, found = _one_by_one(test, state, tested, usable)
    sums, window = moving_sum(q, window)
    nobody = np.zeros((*usable.shape, 0), dtype=bool)
    return runs, window, {**found, "scores": _scores(direction, sums, usable), "code": nobody}


def _one_by_one(
    test: BankTest, state: State, tested: NDArray, usable: NDArray[np.bool_]
) -> tuple[tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64]], dict[str, Any]]:
    """Return alarms and run lengths of what has a threshold of its own, and the decisions that follow from them."""
    statistics = np.full((*usable.shape, len(test.sizes)), np.nan)
    for m, (start, stop) in enumerate(test.columns):
        statistics[..., m] = np.where(usable, row_norms(tested[..., start:stop]) / np.sqrt(test.window), np.nan)
    over = usable[..., None] & (np.where(usable[..., None], statistics, 0.0) > test.thresholds)
    fired, up, down = member_alarms(test, over, usable, state.up, state.down, state.alarm)
    found = {
        "statistic": np.max(statistics / test.thresholds, axis=2),
        "exceeded": over.any(axis=2),
        "alarm": fired.any(axis=2),
        "up": np.where(fired, up, 0).max(axis=2, initial=0),
        "member_statistics": statistics,
        "fired": fired,
    }
    return (fired, up, down), found


def judge_matched(
    test: NormTest,
    matched: MatchedTest,
    state: State,
    q: NDArray,
    window: WindowState,
    usable: NDArray[np.bool_],
    bends: Bends = (),
) -> tuple[_Judged, dict[str, Any]]:
    """Return alarm, run lengths, window and decisions of matched filters, and their fields of the state."""
    sums, window = moving_sum(summed(q, usable), window)
    before = MatchState(state.match_sums, state.match_weights, state.match_held, state.match_extra)
    found, after = match_block(matched, before, q, usable, sums, bends)
    statistic = np.where(usable, np.sqrt(found["ratios"].max(axis=2)), np.nan)
    runs, decided = _against_threshold(test, state, statistic, usable)
    match, after = hold_block(matched, after, found, runs[0], state.alarm, decided["exceeded"], state.count)
    scores = match_scores(matched, found["ratios"], sums, usable)
    return (runs, window, {**decided, "scores": scores, "match": match}), _match_fields(after)


def alarms_since(alarm: NDArray[np.bool_], state: State) -> NDArray[np.int64]:
    """Return when a standing alarm began: how many samples had been seen with that one, 0 where none stands.

    For the members of a bank, when each first fired in the alarm of the bank that stands. Where that is not known, the
    state being one of an earlier version, it stays 0.

    Parameters
    ----------
    alarm : ndarray of bool, shape (plants, time) or (plants, time, members)
        With a sample at least.
    state : State
        Before the block.
    """
    rows = alarm if alarm.ndim == 3 else alarm[..., None]
    plants, time, members = rows.shape
    samples = np.arange(time)
    last_off = np.where(rows.any(axis=2), -1, samples).max(axis=1)
    standing = rows & (samples > last_off[:, None])[..., None]
    first = np.where(standing.any(axis=1), state.count + 1 + standing.argmax(axis=1), 0)
    before, stood = state.since.reshape(plants, members), state.alarm.reshape(plants, members)
    return np.where((last_off == -1)[:, None] & (stood | (before > 0)), before, first).reshape(state.since.shape)


def empty_fields(matched: MatchedTest | None, plants: int, partial: bool) -> dict[str, Any]:
    """Return the fields of a state that matched filters use, before the first sample; without any, empty ones.

    ``partial``: whether the filter goes on where outputs are missing.
    """
    if matched is not None:
        return _match_fields(empty_match(matched, plants, bends=partial))
    nothing = np.zeros((plants, 0, 0))
    return _match_fields(MatchState(nothing, nothing, np.zeros((plants, 0)), nothing))


def _match_fields(state: MatchState) -> dict[str, Any]:
    names = ("sums", "weights", "held", "extra")
    return {f"match_{name}": getattr(state, name) for name in names}


def _scores(test: DirectionTest | None, sums: NDArray, usable: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the correlation of the summed residual with each signature."""
    if test is None:
        return np.zeros((*sums.shape[:2], 0))
    size = row_norms(sums)
    usable = usable & (size > 0)
    size = np.where(usable, size, 1.0)
    scores = np.full((*sums.shape[:2], len(test.bases)), np.nan)
    for g, basis in enumerate(test.bases):
        part = row_norms(ordered_product(sums, basis)) / size
        scores[..., g] = np.where(usable, np.minimum(part, 1.0), np.nan)
    return scores
