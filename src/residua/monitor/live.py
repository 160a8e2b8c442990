"""Running state of a monitor: the state after the last sample, kept in the fused loop if there is one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.isolation import Scores
from residua.decide.test import Tested
from residua.design import ResidualGenerator
from residua.design.core.signals import stacked
from residua.errors import DataError, SettingError
from residua.monitor.decision import Decision, decision_from
from residua.monitor.fused import ALARM, DECIDED, MISSING, OUTPUTS, FusedRun, copied, decisions_of, plan_of
from residua.monitor.running import Decisions, State, initial_state, joined_decisions, run_reference
from residua.monitor.specification import Specification
from residua.monitor.whole_blocks import UNDER_WAY, Job
from residua.visible import echo, listed

#: Samples per piece when a recording is run: bounds memory and lets progress be shown.
PIECE = 100_000
#: Fields that users can request of a block: those of decisions, without their sources.
KEPT = ("residuals", "missing", "aside", "usable", "statistic", "exceeded", "alarm", "up", "scores")
#: Outputs of members, kept in any case.
_OF_MEMBERS = ("member_statistics", "fired", "code")
#: Outputs not needed once a recording is judged.
_PASSING = ("whitened", "ready")


class Live:
    """Running state of a monitor, changed in place by the kernel.

    Parameters
    ----------
    inputs : int
        Channels of u; the others are of y.

    Notes
    -----
    The state is ``None`` before the first sample. Setting it makes the next block go on from there. A block happens
    whole or not at all: see :mod:`residua.monitor.whole_blocks`.
    """

    def __init__(self, inputs: int) -> None:
        self.inputs = inputs
        #: State for the next block: in the kernel if there is one, else the state itself.
        self._run: FusedRun | None = None
        self._kept: State | None = None
        self._is_running = False

    @property
    def state(self) -> State | None:
        """State from which the next block starts."""
        return self._kept if self._run is None else self._run.state

    @state.setter
    def state(self, state: State | None) -> None:
        self._kept = state
        self._run = None

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the kernel, which belongs to the arrays of this object."""
        return {"inputs": self.inputs, "_kept": self.state, "_run": None, "_is_running": False}

    def apart(self) -> Live:
        """Return a copy with its own arrays, which no later block changes."""
        other = Live(self.inputs)
        other.state = copied(self.state)
        return other

    def go_on(
        self, spec: Specification, data: NDArray[np.float64], keep: Sequence[str] | None = None
    ) -> tuple[Decisions, State]:
        """Return the decisions on a block of (plants, time, channels), and the state after it."""
        before = self.state
        if before is not None and len(before.count) != len(data):
            raise DataError(f"the monitor follows {len(before.count)} plants, the block has {len(data)}; reset() first")
        run = self._fused(spec, len(data))
        if run is None:
            state = initial_state(spec, len(data)) if before is None else before
            if self._is_running:
                raise DataError(UNDER_WAY)
            self._is_running = True
            try:
                after, decisions = run_reference(spec, state, data)
            finally:
                self._is_running = False
            self.state = after
            return (decisions if keep is None else _only(decisions, keep)), after
        wanted = OUTPUTS if keep is None else (*keep, *_OF_MEMBERS)
        if keep is not None and not run.plan.names:
            wanted = (*wanted, "residuals", "ready", "usable")
        outputs = run.outputs(data.shape[0], data.shape[1], wanted)
        decisions = run.block(data, outputs)
        return (decisions if keep is None else _only(decisions, keep)), run.state

    def step(self, spec: Specification, generator: ResidualGenerator, u: Any, y: Any) -> Decision | None:
        """Return the decision on one sample, if the kernel can take it unchanged."""
        run = self._run
        if run is None or run.spec is not spec or run.worker.work is not None:  # as a rule it is as it is
            run = self._fused(spec, 1)
        if run is None or not run.steps:
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
        run = self._run
        if run is not None and run.spec is spec:
            run.finish()
            return run
        plan = plan_of(spec)
        if plan is None:
            return None
        before = self.state
        self._run = FusedRun(spec, plan, copied(initial_state(spec, plants) if before is None else before), self.inputs)
        return self._run


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
        run.run(Job(u[:, piece], y[:, piece], places, joined=data[:, piece]))
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
            run.run(Job(part, part[..., :0], places))
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


__all__ = ["KEPT", "PIECE", "Live", "checked_keep", "run_whole"]
