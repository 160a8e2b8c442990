"""Running state of a monitor: the state after the last sample, kept in the fused loop if there is one.

A block changes a copy, which takes the place of the state at its end: an error within, an interruption or a fork in
its middle leaves the state as it was.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from threading import RLock
from typing import Any
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from residua.decide.isolation import Scores
from residua.decide.test import Tested
from residua.design import ResidualGenerator
from residua.design.core.signals import stacked
from residua.errors import DataError, SettingError
from residua.monitor.decision import Decision, decision_from
from residua.monitor.fused import ALARM, DECIDED, MISSING, OUTPUTS, FusedRun, decisions_of, plan_of
from residua.monitor.plant_records import copied
from residua.monitor.running import Decisions, State, initial_state, joined_decisions, run_reference
from residua.monitor.specification import Specification
from residua.visible import echo, listed

#: Samples per piece when a recording is run: bounds memory and lets progress be shown.
PIECE = 100_000
#: Fields that users can request of a block: those of decisions, without their sources.
KEPT = ("residuals", "missing", "aside", "usable", "statistic", "exceeded", "alarm", "up", "scores")
#: Outputs of members, kept in any case.
_OF_MEMBERS = ("member_statistics", "fired", "code")
#: Outputs not needed once a recording is judged.
_PASSING = ("whitened", "ready")
#: Said where a block begins within a block.
UNDER_WAY = (
    "a block is under way: a test or an isolation of your own calls the monitor or the fleet that it runs in, two "
    "threads share a fleet, or this process was forked in the middle of a block. Take what it needs before the block, "
    "or a copy of the monitor"
)


class Online:
    """Running state of a monitor.

    Parameters
    ----------
    inputs : int
        Channels of u; the others are of y.

    Attributes
    ----------
    is_within : bool
        Whether a block is under way.

    Notes
    -----
    The state is ``None`` before the first sample. Setting it makes the next block go on from there.
    """

    def __init__(self, inputs: int, state: State | None = None) -> None:
        self.inputs = inputs
        self.is_within = False
        #: What the next block starts from: the state itself, or the kernel on it, with another one for the next block.
        self._now: tuple[State | None, FusedRun | None, FusedRun | None] = (state, None, None)

    @property
    def state(self) -> State | None:
        """State from which the next block starts."""
        state, run, _ = self._now
        return state if run is None else run.state

    @state.setter
    def state(self, state: State | None) -> None:
        self._now = (state, None, None)

    def __reduce__(self) -> tuple[Any, ...]:
        """Leave out the kernel, which belongs to the arrays of this object."""
        return Online, (self.inputs, self.state)

    def apart(self) -> Online:
        """Return a copy with its own arrays, which no later block changes."""
        return Online(self.inputs, copied(self.state))

    def go_on(
        self, spec: Specification, data: NDArray[np.float64], keep: Sequence[str] | None = None
    ) -> tuple[Decisions, State]:
        """Return the decisions on a block of (plants, time, channels), and the state after it."""
        before = self.state
        if before is not None and len(before.count) != len(data):
            raise DataError(f"the monitor follows {len(before.count)} plants, the block has {len(data)}; reset() first")
        if self.is_within:
            raise DataError(UNDER_WAY)
        try:
            self.is_within = True
            decisions, state = self._block(spec, before, data, keep)
            self.is_within = False
        except BaseException:
            self.is_within = False
            raise
        return (decisions if keep is None else _only(decisions, keep)), state

    def _block(
        self, spec: Specification, before: State | None, data: NDArray[np.float64], keep: Sequence[str] | None
    ) -> tuple[Decisions, State]:
        run = self._fused(spec, len(data))
        if run is None:
            state, decisions = run_reference(spec, before or initial_state(spec, len(data)), data)
            self.state = state
            return decisions, state
        wanted = OUTPUTS if keep is None else (*keep, *_OF_MEMBERS)
        if keep is not None and not run.plan.names:
            wanted = (*wanted, "residuals", "ready", "usable")
        spare = self._now[2]
        after = FusedRun.on_copy(spec, run.plan, run.state, self.inputs) if spare is None else spare.follow(run)
        decisions = after.block(data, after.outputs(data.shape[0], data.shape[1], wanted))
        self._now = (None, after, run)
        return decisions, after.state

    def step(self, spec: Specification, generator: ResidualGenerator, u: Any, y: Any) -> Decision | None:
        """Return the decision on one sample, if the kernel can take it unchanged."""
        run = self._now[1]
        if run is None or run.spec is not spec:  # as a rule it is as it is
            run = self._fused(spec, 1)
        if run is None or not run.steps or self.is_within:  # a step within a block is refused by its checks
            return None
        try:
            flags, statistic = run.step(u, y)
        except (TypeError, ValueError, BufferError):
            return None  # errors in them are reported by their checks
        if flags & ALARM:
            return decision_from(run.last_decisions(), spec, generator, run.state)
        return Decision.quiet(run.last_residual(), statistic, flags & DECIDED != 0, flags & MISSING != 0, generator)

    def _fused(self, spec: Specification, plants: int) -> FusedRun | None:
        """Return the kernel on the state; ``None`` if NumPy runs."""
        run = self._now[1]
        if run is None or run.spec is not spec:
            plan, before = plan_of(spec), self.state
            if plan is None:
                return None
            run = FusedRun.on_copy(spec, plan, initial_state(spec, plants) if before is None else before, self.inputs)
            self._now = (None, run, None)
        return run


_monitors: WeakSet[Any] = WeakSet()


def own_lock(monitor: Any) -> RLock:
    """Return the lock of a monitor, which gets another one in a process that is forked."""
    _monitors.add(monitor)
    return RLock()


def _after_fork() -> None:
    """Let go of what threads held that are not in this process: a block of theirs has left the state as it was."""
    for monitor in _monitors:
        vars(monitor).update(_lock=RLock())
        monitor._online.is_within = False


if sys.platform != "win32":
    os.register_at_fork(after_in_child=_after_fork)


def run_whole(
    spec: Specification,
    u: NDArray[np.float64] | None,
    y: NDArray[np.float64],
    progress: Callable[[int, int], None] | None = None,
) -> tuple[State, Decisions, NDArray[np.float64]]:
    """Run over whole recordings, (plants, time, channels), from a fresh start; progress is reported by pieces.

    Returned with what was decided: the signals, inputs and outputs side by side.
    """
    plan = plan_of(spec)
    if plan is None or not plan.names or u is None or not (u.size and u.flags.c_contiguous and y.flags.c_contiguous):
        data = stacked(u, y)
        return *_run_stacked(spec, data, progress), data
    run, time = FusedRun(spec, plan, copied(initial_state(spec, len(y))), u.shape[-1]), y.shape[1]
    out, data = _kept(run, y), np.empty((*y.shape[:2], u.shape[-1] + y.shape[-1]))
    for start in range(0, time, PIECE):
        piece = slice(start, start + PIECE)
        places = {name: None if values is None else values[:, piece] for name, values in out.items()}
        run.run(u[:, piece], y[:, piece], places, joined=data[:, piece])
        if progress is not None:
            progress(min(start + PIECE, time), time)
    return run.state, decisions_of(out), data


def _kept(run: FusedRun, y: NDArray[np.float64]) -> dict[str, NDArray | None]:
    """Return output arrays for a recording."""
    return run.outputs(len(y), y.shape[1], [name for name in OUTPUTS if name not in _PASSING])


def _run_stacked(
    spec: Specification, data: NDArray[np.float64], progress: Callable[[int, int], None] | None
) -> tuple[State, Decisions]:
    """Run over recordings whose signals lie side by side."""
    state, time = initial_state(spec, len(data)), data.shape[1]
    plan = plan_of(spec)
    run = None if plan is None else FusedRun(spec, plan, copied(state))
    whole = run is not None and run.plan.names  # else isolation runs by pieces, which bounds its memory
    out = _kept(run, data) if run is not None and whole else {}
    parts: list[Decisions] = []
    for start in range(0, max(1, time), PIECE):
        part = data[:, start : start + PIECE]
        if run is None:
            state, decisions = run_reference(spec, state, part)
            parts.append(decisions)
        elif whole:
            places = {n: None if v is None else v[:, start : start + PIECE] for n, v in out.items()}
            run.run(part, part[..., :0], places)
        else:
            parts.append(run.block(part, run.outputs(part.shape[0], part.shape[1])))
        if progress is not None:
            progress(min(start + PIECE, time), time)
    if run is None:
        return state, joined_decisions(parts)
    return run.state, decisions_of(out) if whole else joined_decisions(parts)


def checked_keep(keep: Sequence[str] | None) -> tuple[str, ...] | None:
    """Return the names of the outputs to keep of a block; ``None`` for all."""
    if keep is None:
        return None
    names = (keep,) if isinstance(keep, str) else tuple(keep)
    for name in names:
        if name not in KEPT:
            raise SettingError(f"keep: decisions have no {echo(name)}; they have {listed(KEPT)}")
    return names


def _only(decisions: Decisions, keep: Sequence[str]) -> Decisions:
    """Return decisions with ``None`` in place of outputs that are not kept."""
    tested = decisions.tested
    fields = ("usable", "statistic", "exceeded", "alarm", "up")
    only: Any = {name: getattr(tested, name) if name in keep else None for name in fields}
    made = Tested(**only, whitened=_none(), part_statistics=tested.part_statistics, fired=tested.fired)
    parts: Any = {n: getattr(decisions, n) if n in keep else None for n in ("residuals", "missing", "aside")}
    scores = decisions.named.scores if "scores" in keep else _none()
    return Decisions(**parts, tested=made, named=Scores(scores, code=decisions.named.code))


def _none() -> Any:
    return None


__all__ = ["KEPT", "PIECE", "UNDER_WAY", "Online", "checked_keep", "own_lock", "run_whole"]
