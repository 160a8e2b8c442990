"""The arithmetic of a monitor in NumPy: a pure function from state and data to state and decisions.

Everything here is vectorised over plants and gives the same bits however the time axis is cut.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.isolation import Scores
from residua.decide.matched_recursion import Match
from residua.decide.test import Block, Tested
from residua.monitor.filtering import Filtered, filter_block
from residua.monitor.partial_update import empty_partial
from residua.monitor.plant_records import takes_no_memory
from residua.monitor.specification import FilterState, Specification

#: Responses that are held at once, in numbers.
_MOST_NUMBERS = 10**7


@dataclass(frozen=True, eq=False)
class State:
    """State of a running monitor.

    Attributes
    ----------
    filter : FilterState
    test, isolation : dataclass
        As the test and the isolation have it.
    count : ndarray of int, shape (plants,)
        Samples so far.
    """

    filter: FilterState
    test: Any
    isolation: Any
    count: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Decisions:
    """Decisions of a monitor on a block; every array starts with (plants, time), or (time,) for one plant.

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
    tested : Tested
        Results of the test.
    named : Scores
        Results of the isolation.
    """

    residuals: NDArray[np.float64]
    missing: NDArray[np.bool_]
    aside: NDArray[np.bool_]
    tested: Tested
    named: Scores

    @property
    def statistic(self) -> NDArray[np.float64]:
        """Statistic of the test."""
        return self.tested.statistic

    @property
    def exceeded(self) -> NDArray[np.bool_]:
        """True where the statistic is over its threshold."""
        return self.tested.exceeded

    @property
    def alarm(self) -> NDArray[np.bool_]:
        """True while an alarm stands."""
        return self.tested.alarm

    @property
    def up(self) -> NDArray[np.int64]:
        """Samples in a row over the threshold."""
        return self.tested.up

    @property
    def usable(self) -> NDArray[np.bool_]:
        """True where there is a decision."""
        return self.tested.usable

    @property
    def scores(self) -> NDArray[np.float64]:
        """Scores of the isolation."""
        return self.named.scores

    @property
    def member_statistics(self) -> NDArray[np.float64]:
        """Statistics of the parts tested separately."""
        return self.tested.part_statistics

    @property
    def fired(self) -> NDArray[np.bool_]:
        """True where a part tested separately is in alarm."""
        return self.tested.fired

    @property
    def code(self) -> NDArray[np.bool_]:
        """Mask of the members that count as fired; no columns if no code is read."""
        code = self.named.code
        return np.zeros((*self.usable.shape, 0), dtype=bool) if code is None else code

    @property
    def match(self) -> Match | None:
        """Match of matched filters."""
        return self.named.match

    def of(self, plant: int) -> Decisions:
        """Return the decisions of one plant."""
        return rows_of(self, plant)


def joined_decisions(parts: Sequence[Decisions]) -> Decisions:
    """Return the decisions on consecutive blocks as those on one."""
    return parts[0] if len(parts) == 1 else _joined(parts)


def _joined(parts: Sequence[Any]) -> Any:
    """Return dataclasses of arrays as one, concatenated over blocks."""
    first = parts[0]
    if first is None:
        return None
    if isinstance(first, np.ndarray):
        return np.concatenate(parts, axis=1)
    return type(first)(**{one.name: _joined([getattr(part, one.name) for part in parts]) for one in fields(first)})


def rows_of(whole: Any, plant: int | NDArray[np.int64]) -> Any:
    """Return a dataclass of arrays of one plant, or of some."""
    if whole is None:
        return None
    if isinstance(whole, np.ndarray):
        if isinstance(plant, np.ndarray) and takes_no_memory(whole):
            rows = np.broadcast_to(np.False_, len(whole))[plant]
            return np.broadcast_to(whole.flat[0], (len(rows), *whole.shape[1:]))
        return whole[plant]
    return type(whole)(**{one.name: rows_of(getattr(whole, one.name), plant) for one in fields(whole)})


def initial_state(spec: Specification, plants: int) -> State:
    """Return the state before the first sample."""
    n = len(spec.A)
    whole, counter = np.zeros(plants, dtype=np.int64), np.zeros(plants, dtype=np.int32)
    flag, restarts = np.zeros(plants, dtype=bool), np.broadcast_to(np.int64(0), plants)
    filtered = FilterState(
        x=np.zeros((plants, n)),
        held=np.zeros((plants, spec.held)),
        gap=counter,
        running=flag,
        age=counter,
        resets=restarts,
        broken=restarts,
        starting=flag,
        start_sums=np.broadcast_to(0.0, (plants, 0 if spec.first is None else n)),
        moved=np.broadcast_to(0.0, plants),
        apart=flag,
        **empty_partial(spec.partial, plants),
    )
    return State(filtered, spec.test.start(plants), spec.isolation.start(plants), whole)


def written_rows(whole: Any, rows: NDArray[np.int64], part: Any) -> Any:
    """Return a dataclass of arrays with those of some plants written in place, unless it takes no memory."""
    if whole is None:
        return None
    if isinstance(whole, np.ndarray):
        if takes_no_memory(whole):
            if not part.any():
                return whole
            whole = whole.copy()
        whole[rows] = part
        return whole
    names = [one.name for one in fields(whole)]
    return type(whole)(**{name: written_rows(getattr(whole, name), rows, getattr(part, name)) for name in names})


def run_reference(spec: Specification, state: State, data: NDArray[np.float64]) -> tuple[State, Decisions]:
    """Run filter, test and isolation over a block of samples, in NumPy: the reference for the fused loop.

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
    filter_state, filtered = filter_block(spec, state.filter, data)
    return judged(spec, state, filter_state, filtered)


def judged(
    spec: Specification, state: State, filter_state: FilterState, filtered: Filtered, *, name: bool = True
) -> tuple[State, Decisions]:
    """Run the test, and with ``name`` the isolation, on the filtered block."""
    block = Block(filtered.residuals, filtered.usable, state.count, filtered.bends, filtered.signals)
    test, tested = spec.test.run(state.test, block)
    isolation, named = state.isolation, Scores(np.zeros((*filtered.usable.shape, 0)))
    if name:
        isolation, named = spec.isolation.run(state.isolation, block, tested)
    if tested.likelihood is not None:  # already read by the isolation
        tested = replace(tested, likelihood=None)
    if filtered.usable.shape[1]:
        state = State(filter_state, test, isolation, state.count + filtered.usable.shape[1])
    return state, Decisions(filtered.residuals, filtered.missing, filtered.aside, tested, named)


def _longest_block(spec: Specification, state: State, data: NDArray[np.float64]) -> int:
    """Return the number of samples to run at once, limited by the memory of matched filters with missing outputs."""
    if spec.test.responses is None or spec.partial is None or data.shape[1] < 2:
        return data.shape[1]
    low, high = (spec.plausible + spec.offset[:, None]).T
    if not state.filter.apart.any() and ((data >= low) & (data <= high)).all():
        return data.shape[1]
    return max(1, _MOST_NUMBERS // max(1, state.filter.bent.size))
