"""Fused loop: filter, test and isolation in one pass over the data, if there is a compiled kernel.

It gives the same bits as :mod:`residua.monitor.running`, its reference, which runs where there is no kernel, where
``RESIDUA_NO_COMPILED`` is ``1``, or where a test or an isolation is not written in C. What a Kalman filter needs where
values are missing, its covariances and room for those of every plant, is brought when the first value is missing.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.compiled import STATISTICS, CompiledCodes, CompiledIsolation, CompiledTest
from residua.decide.isolation import Scores
from residua.decide.test import Block, Tested
from residua.kernels import kernel
from residua.linear.systems.recursion import best_path, compiled
from residua.monitor.plant_records import SELDOM, copied, records_and_block, takes_no_memory, written_rows
from residua.monitor.running import Decisions, State, run_reference
from residua.monitor.specification import Specification
from residua.monitor.start_estimate import MOVED_FROM

_kernel = kernel("residua.monitor._fused")

#: Outputs of a block, in the order of the kernel.
OUTPUTS = (
    *("residuals", "missing", "aside", "usable", "statistic", "exceeded", "alarm", "up", "whitened", "scores", "ready"),
    *("member_statistics", "fired", "code"),
)
#: Receipt of the kernel for a part of a block: that it has run, how many of its plants stopped for want of room,
#: whether one did for want of gains, and how many notes there are.
_RAN, _STOPPED, _WANTS_GAINS, _NOTED = range(4)
#: Plants of a part that are noted, and numbers of a note before the sums of a start, as in the kernel.
_NOTES, _NOTE_HEAD = 64, 5

_OF_PARTS = ("member_statistics", "fired", "code")
_TYPES = {
    "ready": bool,
    "missing": bool,
    "aside": bool,
    "usable": bool,
    "exceeded": bool,
    "alarm": bool,
    "up": np.int64,
    "fired": bool,
    "code": bool,
}
#: Fields for starts of filters, and counters of restarts: usually zero.
_OF_STARTS, _RESTARTS = ("start_sums", "moved"), ("resets", "broken")
#: Flags in the number that a step returns: alarm, whether it was decided, and whether a value was missing; that the
#: plant was left, besides.
ALARM, DECIDED, MISSING, _IS_LEFT = 1, 2, 4, 8


@dataclass(frozen=True, eq=False)
class Plan:
    """Arguments of the kernel from a specification, in its order.

    Attributes
    ----------
    integers, numbers : ndarray
    arrays : tuple of ndarray or None
    widths : mapping of str to int
        Columns of each output; 0 for one without an axis of its own.
    names : bool
        Whether the isolation is in C too.
    """

    integers: NDArray[np.int64]
    numbers: NDArray[np.float64]
    arrays: tuple[NDArray | None, ...]
    widths: dict[str, int]
    names: bool


def plan_of(spec: Specification) -> Plan | None:
    """Return the arguments of the kernel; ``None`` if NumPy runs. It is made once for a specification."""
    if _kernel is None or not compiled():
        return None
    known = spec.__dict__.get("_plan", False)
    if known is False:
        test = spec.test.compiled
        usual = test is not None and spec.test.responses is None and not spec.test.reads_signals
        known = _plan(spec, test) if usual and test is not None else None
        object.__setattr__(spec, "_plan", known)
    return known


def compiled_isolation(spec: Specification) -> CompiledIsolation | CompiledCodes | None:
    """Return the isolation for the loop; codes need as many parts as they have members."""
    named, test = spec.isolation.compiled, spec.test.compiled
    parts = 0 if test is None or test.sizes is None else len(test.sizes)
    return None if isinstance(named, CompiledCodes) and len(named.codes) != parts else named


def _plan(spec: Specification, test: CompiledTest) -> Plan:
    named = compiled_isolation(spec)
    codes = named if isinstance(named, CompiledCodes) else None
    naming = named if isinstance(named, CompiledIsolation) else CompiledIsolation()
    members, groups = (0, len(naming.bases)) if codes is None else codes.codes.shape
    parts = 0 if test.sizes is None else len(test.sizes)
    channels, k = spec.B.shape[1], test.whitening.shape[1]
    largest = np.finfo(np.float64).max
    plausible = np.clip(spec.plausible, -largest, largest)  # infinity is not a measurement, however wide the range
    first = spec.first
    integers = [
        len(spec.A), channels, 0, len(spec.C), spec.settle, spec.max_hold,
        0 if first is None else first.samples, 0 if first is None else first.ratios.shape[1], spec.partial is not None,
        STATISTICS.index(test.statistic) + 1, k, test.window, test.persistence, test.release,
        0 if test.coefficients is None else len(test.coefficients), 0 if test.scores is None else len(test.scores),
        test.sums, 0 if test.along is None else test.along.shape[1], groups,
        naming.window if codes is None else codes.window, sum(basis.shape[1] for basis in naming.bases),
        parts, members, codes is not None and codes.at_once,
        0 if spec.partial is None else spec.partial.B.shape[1],
        0 if test.weights is None else len(test.weights),
    ]  # fmt: skip
    numbers = [
        *(test.threshold, test.release_level, test.allowance, 1 - test.weight, test.weight, test.deviation),
        *(0.0 if codes is None else codes.share, MOVED_FROM, naming.clear),
    ]
    started = (None, None, None) if first is None else (first.rows, first.correction, first.ratios)
    bases = np.hstack(naming.bases) if naming.bases else None
    arrays = (
        spec.A, spec.B, spec.C, spec.D, spec.start, spec.offset, *plausible.T, *started, test.center,
        test.whitening, test.coefficients, test.rewhitening, test.knots, test.scores, test.along, bases,
    )  # fmt: skip
    dimensions = np.array([basis.shape[1] for basis in naming.bases], dtype=np.int64) if naming.bases else None
    sizes = None if test.sizes is None else np.ascontiguousarray(test.sizes, dtype=np.int64)
    limits, joint = (None if a is None else np.ascontiguousarray(a, dtype=float) for a in (test.limits, test.joint))
    table = None if codes is None else np.ascontiguousarray(codes.codes.T, dtype=bool)
    means = None
    if test.weights is not None and test.scaling is not None:
        means = np.concatenate([test.weights, *test.lengths, test.scaling.ravel()])
    widths = {"residuals": len(spec.C), "aside": channels, "whitened": k, "scores": groups}
    widths |= {"member_statistics": parts, "fired": parts, "code": members}
    return Plan(
        np.array(integers, dtype=np.int64),
        np.array(numbers, dtype=float),
        (
            *(None if a is None else np.ascontiguousarray(a, dtype=float) for a in arrays),
            *(dimensions, sizes, limits, joint, table, means),
        ),
        widths,
        named is not None,
    )


def state_arrays(spec: Specification, state: State) -> tuple[NDArray | None, ...]:
    """Return the arrays of a state in the order of the kernel; ``None`` for those that it does not read."""
    f = state.filter
    named, naming = compiled_isolation(spec), (None,) * 5
    if isinstance(named, CompiledCodes):
        naming = state.isolation.arrays()
    elif named is not None and named.bases:
        naming = (*state.isolation.arrays(), None, None)
    remembered = (one if one is None or one.flags.writeable else None for one in (*state.test.arrays(), *naming))
    resets, broken, sums, moved, spread = (
        one if _has_room(one) else None for one in (f.resets, f.broken, f.start_sums, f.moved, f.spread)
    )
    return (
        f.x, f.held, f.gap, f.running, f.age, resets, broken, f.starting, sums, moved, f.apart, spread, state.count,
        *remembered,
    )  # fmt: skip


def _has_room(seldom: NDArray) -> bool:
    """Tell whether a state has allocated a field that is usually zero, such as an extra covariance."""
    return bool(seldom.size) and not takes_no_memory(seldom)


def with_room(state: State, names: Iterable[str]) -> State:
    """Return a state with fields that are usually zero allocated; memory is only used where it is written."""
    filtered = state.filter
    now = {name: getattr(filtered, name) for name in names}
    room = {name: np.zeros(one.shape, one.dtype) for name, one in now.items() if takes_no_memory(one)}
    return replace(state, filter=replace(filtered, **room)) if room else state


def with_starts(spec: Specification, state: State) -> State:
    """Return the state of new plants with allocated fields for their starts, which all come soon."""
    if spec.first is None or not len(state.count):
        return state
    state = with_room(state, _OF_STARTS)
    state.filter.start_sums[...] = 0.0  # the memory is provided here, not within the first tick
    return state


def _there(values: NDArray | None) -> NDArray:
    assert values is not None
    return values


@dataclass(frozen=True, eq=False)
class LastSample:
    """Decisions on the last sample of every plant, a row each, in the order of the kernel.

    Attributes
    ----------
    flags : ndarray of uint8
        1 in alarm, 2 decided, 4 a value missing, added.
    statistic : ndarray
    residuals : ndarray, shape (plants, residuals)
    up : ndarray of int
        Samples in a row over the threshold.
    scores : ndarray, shape (plants, groups)
        Of those in alarm.
    code : ndarray of bool, shape (plants, members), or None
        Where a code is read: which members count as fired.
    """

    flags: NDArray[np.uint8]
    statistic: NDArray[np.float64]
    residuals: NDArray[np.float64]
    up: NDArray[np.int64]
    scores: NDArray[np.float64]
    code: NDArray[np.bool_] | None = None

    @staticmethod
    def blank(plants: int, residuals: int, groups: int, members: int = 0) -> LastSample:
        """Return the decisions before the first sample; ``members`` of a code, if one is read."""
        return LastSample(
            np.zeros(plants, dtype=np.uint8),
            np.full(plants, np.nan),
            np.full((plants, residuals), np.nan),
            np.zeros(plants, dtype=np.int64),
            np.full((plants, groups), np.nan),
            np.zeros((plants, members), dtype=bool) if members else None,
        )

    def remember(self, rows: NDArray[np.int64], made: Decisions) -> None:
        """Keep the last sample of decisions on some plants."""
        flags = (made.alarm, made.usable, made.missing)
        self.flags[rows] = sum((one[:, -1].astype(np.uint8) << bit for bit, one in enumerate(flags)), np.uint8(0))
        self.statistic[rows], self.residuals[rows] = made.statistic[:, -1], made.residuals[:, -1]
        self.up[rows] = made.up[:, -1]
        loud = made.alarm[:, -1]
        self.scores[rows[loud]] = made.scores[loud, -1]
        if self.code is not None:
            self.code[rows] = made.code[:, -1]


class Job:
    """A block that the kernel runs in place, which goes on where it was interrupted.

    Errors that signals, such as Ctrl-C, and a want of memory raise come between any two steps of Python, but never
    within a call of the kernel. So the kernel writes down what it has run, and all else may be done again.

    Parameters
    ----------
    run : FusedRun
    u, y : ndarray, shape (plants, time, channels)
    outputs : mapping of str to ndarray or None
        Arrays for the outputs of the block, by all names of :data:`OUTPUTS`.
    rows : ndarray of int, shape (plants,), optional
        Whose data they are: each row of the state once. All rows in order when omitted.
    threads : int
        The plants are shared among so many.
    joined : ndarray, shape (plants, time, channels), optional
        Where to put u and y side by side.

    Attributes
    ----------
    out : mapping of str to ndarray or None
        The outputs.
    then : list of callable
        Steps after the kernel; they may be repeated.
    is_done : bool
    is_borrowed : bool
        Whether the signals are still those of the caller, who may change them once an error has reached him.
    """

    def __init__(
        self,
        run: FusedRun,
        u: NDArray,
        y: NDArray,
        outputs: dict[str, NDArray | None],
        rows: NDArray[np.int64] | None = None,
        *,
        threads: int = 1,
        joined: NDArray[np.float64] | None = None,
    ) -> None:
        self._run, self._signals, self._rows, self._threads, self._joined = run, (u, y), rows, threads, joined
        self.out: dict[str, Any] = outputs
        self._left = np.zeros(len(y), dtype=np.int64)  # samples; written, and read, only where it has to be
        self._is_fresh = True
        self._parts: _Parts | None = None
        self.is_done, self.is_borrowed, self.then = False, True, []

    @property
    def is_begun(self) -> bool:
        """True if a plant has been run."""
        return self.is_done or not self._is_fresh or (self._parts is not None and self._parts.any_has_run)

    def perform(self) -> None:
        """Do the rest."""
        while not self.is_done:
            if self._parts is None:
                self._parts = self._run.parts(len(self._left), self._threads)
            outputs = tuple(self.out[name] for name in OUTPUTS)
            kernel, block = self._run.kernel, (*self._signals, outputs, self._rows, self._left, self._is_fresh)
            self._parts.run(lambda *part, kernel=kernel, block=block: kernel.run(*block, *part, self._joined))
            stopped, wants_gains, noted = self._parts.told()
            if noted:
                self._run.take_in(self._parts.notes())
            if wants_gains:
                self._run.make_room(("spread",))
            if stopped:
                self._is_fresh, self._parts = False, None
                continue
            for step in self.then:
                step()
            self.is_done = True

    def own(self) -> None:
        """Copy borrowed signals, once no thread runs plants, if the job is begun and not done."""
        self.wait()
        if self.is_begun and not self.is_done and self.is_borrowed:
            u, y = self._signals
            self._signals = u.copy(), y.copy()
        self.is_borrowed = False

    def wait(self) -> None:
        """Wait for the threads that run plants, and let no other one begin."""
        if self._parts is not None:
            self._parts.wait()


class _Parts:
    """Plants of a block in parts, each of which runs once, in any thread."""

    def __init__(self, plants: int, threads: int, states: int) -> None:
        count = 1 if plants < 2 * threads else threads
        self._ends = list(pairwise([plants * k // count for k in range(count + 1)]))
        self._receipts = np.zeros((count, 4), dtype=np.int64)
        self._notes = np.empty((count, _NOTES, _NOTE_HEAD + states))
        #: When a part is over, by the thread that runs it; ``None``: the calling one does. The first to write it does.
        self._claims: dict[int, threading.Event | None] = {}

    def again(self, plants: int) -> bool:
        """Restart with so many plants, if no other thread knows of this."""
        if len(self._ends) > 1 or self._ends[0][1] != plants:
            return False
        self._receipts[:] = 0
        return True

    @property
    def any_has_run(self) -> bool:
        return bool(self._receipts[:, _RAN].any())

    def run(self, run: Callable[..., object]) -> None:
        """Run the remaining parts; the calling thread does the part of a thread that does not start.

        ``run`` takes the first plant of a part, the one after its last, a receipt and room for notes.
        """
        if len(self._ends) == 1:
            self._run(run, 0)
            return
        for k in range(1, len(self._ends)):
            try:
                threading.Thread(target=self._help, args=(run, k)).start()
            except (RuntimeError, MemoryError):
                break
        for k in range(len(self._ends)):
            if self._claims.setdefault(k, None) is None:
                self._run(run, k)
        self.wait()
        for k in range(len(self._ends)):  # parts left by a thread with an error, which occurs again here
            self._run(run, k)

    def _help(self, run: Callable[..., object], k: int) -> None:
        """Run a part in another thread, unless it is too late."""
        is_over = threading.Event()
        if self._claims.setdefault(k, is_over) is is_over:
            try:
                self._run(run, k)
            except Exception:
                pass
            finally:
                is_over.set()

    def _run(self, run: Callable[..., object], k: int) -> None:
        if not self._receipts[k, _RAN]:
            run(*self._ends[k], self._receipts[k], self._notes[k])

    def wait(self) -> None:
        for k in range(len(self._ends)):
            is_over = self._claims.setdefault(k, None)
            if is_over is not None:
                is_over.wait()

    def told(self) -> tuple[int, int, int]:
        """Return the number of plants that stopped, of parts that want gains, and of notes."""
        first, *others = self._receipts.tolist()
        _, stopped, wants_gains, noted = first if not others else map(sum, zip(first, *others, strict=True))
        return stopped, wants_gains, noted

    def notes(self) -> NDArray[np.float64]:
        """Return the notes of all parts, a row each."""
        counts = self._receipts[:, _NOTED]
        return np.concatenate([notes[:count] for notes, count in zip(self._notes, counts, strict=True)])


class FusedRun:
    """A state that is run in place, with the kernel that runs it.

    Parameters
    ----------
    spec : Specification
    plan : Plan
    state : State
        Its arrays change.
    inputs : int, optional
        Channels that come as ``u``, the others as ``y``; all when omitted.
    last : LastSample, optional
        Where to keep the decisions on the last sample of every plant.

    Attributes
    ----------
    state : State
        After the last block.
    kernel : Runner
        On the arrays of the state.
    steps : bool
        Whether it runs single samples, with their isolation.
    """

    def __init__(
        self, spec: Specification, plan: Plan, state: State, inputs: int | None = None, last: LastSample | None = None
    ) -> None:
        self.plants = len(state.count)
        if self.plants == 1:  # of one plant there always is room
            state = with_room(state, _OF_STARTS + _RESTARTS)
        elif state.filter.starting.any():
            state = with_room(state, _OF_STARTS)
        self.spec, self.plan, self.last = spec, plan, last
        integers = plan.integers.copy()
        self._inputs = int(integers[1]) if inputs is None else inputs
        integers[1:3] = self._inputs, integers[1] - self._inputs
        self._integers = integers
        self.steps = plan.names and self.plants == 1
        #: The state, the kernel on its arrays, and its outputs of single samples: changed together, at once.
        self._on: tuple[State, Any, dict[str, NDArray | None] | None] = (state, self._runner(state), None)
        self._block: NDArray[np.uint8] = np.zeros(0, dtype=np.uint8)
        self._known: tuple[State, list[NDArray]] | None = None
        self._last = np.empty(0)  # the residual that single samples are written to
        self._parts: _Parts | None = None

    @property
    def state(self) -> State:
        """State of all plants after the last block."""
        return self._on[0]

    def parts(self, plants: int, threads: int) -> _Parts:
        """Return the parts of a block; those of the last block again where they fit, which saves a fifth of a tick."""
        if self._parts is None or threads > 1 or not self._parts.again(plants):
            self._parts = _Parts(plants, threads, len(self.spec.A))
        return self._parts

    @property
    def kernel(self) -> Any:
        """The kernel on the arrays of the state."""
        return self._on[1]

    def _runner(self, state: State) -> Any:
        assert _kernel is not None
        plan, spec = self.plan, self.spec
        names = [one.name for one in fields(LastSample)]
        kept = [None if self.last is None else getattr(self.last, name) for name in names]
        if not plan.widths["scores"]:
            kept[names.index("scores")] = None
        partial = spec.partial if _has_room(state.filter.spread) else None
        arrays = (*plan.arrays, None if partial is None else partial.numbers)
        remembered = (*state_arrays(spec, state), *kept)
        return _kernel.Runner(self._integers, plan.numbers, arrays, remembered, self.plants, best_path())

    def _use(self, state: State, one: dict[str, NDArray | None] | None = None) -> None:
        """Use the arrays of another state; ``one``: outputs of single samples."""
        runner = self._runner(state)
        if one is not None:
            runner.bind(tuple(one[name] for name in OUTPUTS))
        self._on = (state, runner, one)

    def make_room(self, names: Iterable[str]) -> None:
        """Allocate fields that are usually zero: with missing values, a Kalman filter needs its covariance."""
        self._use(with_room(self._on[0], names), self._on[2])

    @staticmethod
    def on_copy(spec: Specification, plan: Plan, state: State, inputs: int | None) -> FusedRun:
        """Return a run on a copy of a state, in one block of memory, which another one can follow."""
        (records,), block = records_and_block([state])
        run = FusedRun(spec, plan, records, inputs)
        run._block = block
        return run

    def follow(self, other: FusedRun) -> FusedRun:
        """Return a run with a copy of the state of another one, both on copies: itself, if it has the same room."""
        own, new = self._memory(), other._memory()
        if len(own) != len(new) or any(one.shape != values.shape for one, values in zip(own, new, strict=True)):
            return FusedRun.on_copy(self.spec, self.plan, other.state, self._inputs)
        for one, values in zip(own, new, strict=True):
            one[...] = values
        if not self.plan.names:
            self._on = (replace(self.state, isolation=other.state.isolation), *self._on[1:])
        return self

    def _memory(self) -> list[NDArray]:
        """Return the memory of the state, looked up once for a state."""
        state = self._on[0]
        if self._known is None or self._known[0] is not state:
            seldom = (getattr(state.filter, name) for name in SELDOM)
            self._known = (state, [self._block, *(one for one in seldom if _has_room(one))])
        return self._known[1]

    @property
    def has_room_for_starts(self) -> bool:
        """True if the fields for estimated starts are allocated."""
        return _has_room(self._on[0].filter.start_sums)

    def let_go_of_starts(self) -> None:
        """Release the fields for estimated starts, if no plant starts."""
        state = self._on[0]
        if state.filter.starting.any():
            return
        room = {name: one for name in _OF_STARTS if not (one := getattr(state.filter, name)).any()}
        gone = {name: np.broadcast_to(one.dtype.type(0), one.shape) for name, one in room.items()}
        self._use(replace(state, filter=replace(state.filter, **gone)))

    def take_in(self, notes: NDArray[np.float64]) -> None:
        """Write the values for which the kernel had no room: restarts of plants, and starts in progress."""
        state, n = self._on[0], self._on[0].filter.x.shape[1]
        kind = [("row", "i8"), ("resets", "i8"), ("broken", "i8"), ("starting", "i8"), ("moved", "f8")]
        table = np.ascontiguousarray(notes).view(np.dtype([*kind, ("start_sums", "f8", (n,))]))[:, 0]
        restarts = [name for name in _RESTARTS if table[name].any()]
        starts = _OF_STARTS if table["starting"].any() else _OF_STARTS[1:] if table["moved"].any() else ()
        wanted = [*restarts, *starts]
        roomy = with_room(state, wanted)
        for name in wanted:  # where there was room the kernel has written by itself
            if takes_no_memory(getattr(state.filter, name)):
                getattr(roomy.filter, name)[table["row"]] = table[name]
        self._use(roomy, self._on[2])

    def write(self, rows: NDArray[np.int64], state: State) -> None:
        """Replace the states of some plants."""
        before = self.state
        after = written_rows(before, rows, state)
        if state.filter.starting.any():
            after = with_room(after, _OF_STARTS)
        if any(getattr(after.filter, name) is not getattr(before.filter, name) for name in SELDOM):
            self._use(after)

    def outputs(self, plants: int, time: int, keep: Sequence[str] = OUTPUTS) -> dict[str, NDArray | None]:
        """Return output arrays of a block: zeros, for much of it is written only where it is not zero."""
        out: dict[str, NDArray | None] = {}
        for name in OUTPUTS:
            width = self.plan.widths.get(name)
            shape = (plants, time) if width is None else (plants, time, width)
            kept = name in keep and not (name == "ready" and self.plan.names)
            kept = kept and not (name in _OF_PARTS and not width)
            out[name] = np.zeros(shape, dtype=_TYPES.get(name, np.float64)) if kept else None
        return out

    def run(self, u: NDArray, y: NDArray, outputs: dict[str, NDArray | None], *rows: NDArray, **options: Any) -> None:
        """Process a block, with the arguments of a :class:`Job`."""
        Job(self, u, y, outputs, *rows, **options).perform()

    def block(self, data: NDArray[np.float64], outputs: dict[str, NDArray | None]) -> Decisions:
        """Process a block of (plants, time, channels), and return its decisions, isolation included."""
        decisions, count = decisions_of(outputs), self.state.count.copy()
        self.run(data[..., : self._inputs], data[..., self._inputs :], outputs)
        if self.plan.names:
            return decisions
        state, runner, one = self._on
        block = Block(decisions.residuals, _there(outputs["ready"]), count)
        isolation, named = self.spec.isolation.run(state.isolation, block, decisions.tested)
        self._on = (replace(state, isolation=isolation), runner, one)
        return replace(decisions, named=named)

    # ------------------------------------------------------------------------ one sample

    def step(self, u: Any, y: Any) -> tuple[int, float]:
        """Process one sample of one plant, and return a sum of flags, and the statistic.

        Raises a Python error unless u and y are arrays of floats with one number per channel.
        """
        if self._on[2] is None:
            one = self.outputs(1, 1)
            self._last = _there(one["residuals"])[0, 0]
            self._use(self._on[0], one)
        told = self._on[1].step(u, y)
        if told[0] & _IS_LEFT:
            self.make_room(("spread",))
            told = self._on[1].step(u, y)
        return told

    def last_residual(self) -> NDArray[np.float64]:
        """Return the residual of the last step."""
        return self._last.copy()

    def last_decisions(self) -> Decisions:
        """Return the decisions of the last step."""
        assert self._on[2] is not None
        return decisions_of({name: None if values is None else values.copy() for name, values in self._on[2].items()})


def decisions_of(outputs: dict[str, Any]) -> Decisions:
    """Return the outputs of a block as decisions; names are those of an isolation in C."""
    shape = () if outputs["alarm"] is None else outputs["alarm"].shape
    nobody = np.zeros((*shape, 0))
    usable, statistic, exceeded, alarm, up = (outputs[n] for n in ("usable", "statistic", "exceeded", "alarm", "up"))
    whitened = nobody if outputs["whitened"] is None else outputs["whitened"]
    parts, fired, code = (outputs.get(name) for name in _OF_PARTS)
    if parts is None or fired is None:
        parts, fired = nobody, nobody.astype(bool)
    tested = Tested(usable, statistic, exceeded, alarm, up, whitened, parts, fired)
    named = Scores(outputs["scores"], code=code)
    return Decisions(outputs["residuals"], outputs["missing"], outputs["aside"], tested, named)


def run_block(spec: Specification, state: State, data: NDArray[np.float64]) -> tuple[State, Decisions]:
    """Run filter, test and isolation over a block of samples; see :func:`residua.monitor.running.run_reference`."""
    plan = plan_of(spec)
    if plan is None:
        return run_reference(spec, state, data)
    run = FusedRun(spec, plan, copied(state))
    decisions = run.block(data, run.outputs(data.shape[0], data.shape[1]))
    return run.state, decisions


__all__ = [
    "ALARM",
    "DECIDED",
    "MISSING",
    "OUTPUTS",
    "FusedRun",
    "Job",
    "LastSample",
    "Plan",
    "decisions_of",
    "plan_of",
    "run_block",
    "with_starts",
]
