"""Blocks of samples that happen whole or not at all, in spite of interruptions and of threads that do not start.

Signals, such as Ctrl-C, and a want of memory raise errors between any two steps of Python, but never within a call of
the kernel. So the kernel itself writes down which plants it has run, and whatever follows can be done again from any
point in it on. What an interruption leaves open is done before anything else is: see :class:`Work`.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError

#: Outputs of a block, in the order of the kernel.
OUTPUTS = (
    *("residuals", "missing", "aside", "usable", "statistic", "exceeded", "alarm", "up", "whitened", "scores", "ready"),
    *("member_statistics", "fired", "code"),
)
#: Receipt of the kernel for a part: that it has run, how many of its plants stopped for want of room, whether one
#: did for want of gains, and how many notes there are.
RAN, STOPPED, WANTS_GAINS, NOTED = range(4)
#: Plants of a part that are noted, and numbers of a note before the sums of a start, as in the kernel.
_NOTES, _NOTE_HEAD = 64, 5
#: Said where a block begins within a block.
UNDER_WAY = (
    "a block is under way: a test or an isolation of your own calls the monitor or the fleet that it runs in, two "
    "threads share a fleet, or this process was forked in the middle of a block. Take what it needs before the block, "
    "or a copy of the monitor"
)


class Parts:
    """Plants of a block in parts, each of which runs once, in any thread.

    Parameters
    ----------
    plants, threads : int
    states : int
        Of the filter.

    Attributes
    ----------
    receipts : ndarray of int, shape (parts, 4)
    """

    def __init__(self, plants: int, threads: int, states: int) -> None:
        count = 1 if plants < 2 * threads else threads
        self._ends = list(pairwise([plants * k // count for k in range(count + 1)]))
        self.receipts = np.zeros((count, 4), dtype=np.int64)
        self._notes = np.empty((count, _NOTES, _NOTE_HEAD + states))
        #: Who runs a part: a thread, or ``None``, the calling one. The first to write it here does.
        self._claims: dict[int, _Helper | None] = {}

    def again(self, plants: int) -> bool:
        """Restart with so many plants, if no other thread knows of this."""
        if len(self._ends) > 1 or self._ends[0][1] != plants:
            return False
        self.receipts[:] = 0
        return True

    def run(self, run: Callable[..., object]) -> None:
        """Run the remaining parts; the calling thread does the part of a thread that does not start.

        ``run`` takes the first plant of a part, the one after its last, a receipt and room for notes.
        """
        if len(self._ends) == 1:
            self._run(run, 0)
            return
        for k in range(1, len(self._ends)):
            try:
                _Helper(self, run, k).start()
            except (RuntimeError, MemoryError):
                break
        for k in range(len(self._ends)):
            if self._claims.setdefault(k, None) is None:
                self._run(run, k)
        self.wait()
        for k in range(len(self._ends)):  # parts left by a thread with an error, which occurs again here
            self._run(run, k)

    def help(self, helper: _Helper, run: Callable[..., object], k: int) -> None:
        """Run a part in another thread, unless it is too late."""
        if self._claims.setdefault(k, helper) is helper:
            self._run(run, k)

    def _run(self, run: Callable[..., object], k: int) -> None:
        if not self.receipts[k, RAN]:
            run(*self._ends[k], self.receipts[k], self._notes[k])

    def wait(self) -> None:
        """Wait for the threads that run a part, and let no other one begin."""
        for k in range(len(self._ends)):
            helper = self._claims.setdefault(k, None)
            if helper is not None:
                helper.wait()

    def told(self) -> tuple[int, int, int]:
        """Return the number of plants that stopped, of parts that want gains, and of notes."""
        first, *others = self.receipts.tolist()
        _, stopped, wants_gains, noted = first if not others else map(sum, zip(first, *others, strict=True))
        return stopped, wants_gains, noted

    def notes(self) -> NDArray[np.float64]:
        """Return the notes of all parts, a row each."""
        return np.concatenate(
            [notes[:count] for notes, count in zip(self._notes, self.receipts[:, NOTED], strict=True)]
        )


class _Helper:
    """A thread that runs a part of a block, unless another one already has."""

    def __init__(self, parts: Parts, run: Callable[..., object], k: int) -> None:
        self._thread = threading.Thread(target=self._help, args=(parts, run, k))
        self._is_over = False
        self._latch = threading.Lock()
        self._latch.acquire()

    def start(self) -> None:
        self._thread.start()

    def _help(self, parts: Parts, run: Callable[..., object], k: int) -> None:
        try:
            with suppress(Exception):
                parts.help(self, run, k)
        finally:
            self._is_over = True
            self._latch.release()

    def wait(self) -> None:
        """Wait for its end; an interruption loses nothing that others wait for."""
        if not self._is_over:
            self._latch.acquire()


class Job:
    """A block that the kernel runs in place, with its progress.

    Parameters
    ----------
    u, y : ndarray, shape (plants, time, channels)
    outputs : mapping of str to ndarray or None
        Arrays for the outputs of the block, by all names of :data:`OUTPUTS`.
    rows : ndarray of int, shape (plants,), optional
        Whose data they are: each row of the state once. All rows in order when omitted.
    threads : int
        The plants are shared among so many.
    then : callable, optional
        Steps after the kernel; they may be repeated.
    joined : ndarray, shape (plants, time, channels), optional
        Where to put u and y side by side.

    Attributes
    ----------
    is_done : bool
    is_borrowed : bool
        Whether the signals are still those of the caller, who may change them once an error has reached him.
    """

    def __init__(
        self,
        u: NDArray,
        y: NDArray,
        outputs: Mapping[str, NDArray | None],
        rows: NDArray[np.int64] | None = None,
        *,
        threads: int = 1,
        then: Callable[[], None] | None = None,
        joined: NDArray[np.float64] | None = None,
    ) -> None:
        self.signals, self.rows, self.threads, self.then, self.joined = (u, y), rows, threads, then, joined
        self.outputs = tuple(outputs[name] for name in OUTPUTS)
        self.left = np.zeros(len(y), dtype=np.int64)  # samples; written, and read, only where it has to be
        self.is_fresh, self.is_done, self.is_borrowed = True, False, True
        self.parts: Parts | None = None

    @property
    def is_begun(self) -> bool:
        """True if a plant has been run."""
        return self.is_done or not self.is_fresh or (self.parts is not None and bool(self.parts.receipts[:, RAN].any()))

    def run(self, kernel: Any, first: int, stop: int, receipt: NDArray, notes: NDArray) -> None:
        """Run some of the plants."""
        call = (
            *self.signals,
            self.outputs,
            self.rows,
            self.left,
            self.is_fresh,
            first,
            stop,
            receipt,
            notes,
            self.joined,
        )
        kernel.run(*call)

    def end_round(self) -> None:
        """Let the next round run the remaining plants."""
        self.is_fresh = False
        self.parts = None

    def own(self) -> None:
        """Copy borrowed signals, if the job is not done."""
        if self.is_borrowed and not self.is_done:
            u, y = self.signals
            self.signals = u.copy(), y.copy()
        self.is_borrowed = False


class Work:
    """Steps that happen all or not at all.

    Parameters
    ----------
    steps : sequence of callable
        Each may be begun again where it was interrupted, and after its end: it then does the rest, or nothing.
    jobs : sequence of Job
        Jobs of the kernel in them.
    within : sequence of Work
        Work that these steps do.
    undo : callable, optional
        What takes back all that the steps did; it may be done again. It is done where a step raises, or is interrupted;
        without it, what is left of the steps is done.
    """

    def __init__(
        self,
        steps: Sequence[Callable[[], object]],
        jobs: Sequence[Job],
        within: Sequence[Work] = (),
        undo: Callable[[], object] | None = None,
    ) -> None:
        self.steps, self.jobs, self._within, self._undo = steps, jobs, within, undo
        self._done, self._is_undone, self.is_under_way = 0, False, False

    @property
    def is_begun(self) -> bool:
        """True if anything was changed."""
        begun = self._done > 0 or any(one.is_begun for one in (*self.jobs, *self._within))
        return begun and not self._is_undone

    def go_on(self) -> None:
        """Do the remaining steps."""
        try:
            self.is_under_way = True
            while self._done < len(self.steps):
                self.steps[self._done]()
                self._done += 1
        finally:
            self.is_under_way = False

    def wait(self) -> None:
        """Wait for the threads that are at it, and let no other one begin."""
        for job in self.jobs:
            if job.parts is not None:
                job.parts.wait()

    def own(self) -> None:
        """Prepare for a later continuation, when the caller may have changed its signals, or for undoing."""
        self.is_under_way = False  # where an interruption came just before that was written
        self.wait()
        if self.is_begun and not self.take_back():
            for job in self.jobs:
                job.own()

    def take_back(self) -> bool:
        """Undo all that was done, and return whether that can be."""
        if self._undo is None:
            return False
        self._undo()
        self._is_undone = True
        return True


class Worker:
    """Worker for one piece of work after the other; interrupted work is finished before anything else."""

    def __init__(self) -> None:
        #: Work in progress, or interrupted.
        self.work: Work | None = None

    def do(self, work: Work) -> None:
        """Do all of some work.

        An error leaves nothing changed, or work of which :meth:`finish` does the rest.
        """
        try:
            self.work = work
            work.go_on()
        except BaseException:
            work.own()
            raise
        self.work = None

    def finish(self) -> None:
        """Finish interrupted work, if it changed anything.

        Raises
        ------
        DataError
            If that was interrupted so often that the signals are not there any longer, or is being done: a step has
            called what it is a step of.
        """
        work = self.work
        if work is None:
            return
        if work.is_under_way:
            raise DataError(UNDER_WAY)
        work.wait()  # an interruption may have come in the middle of this, too
        if work.is_begun and not work.take_back():
            if any(job.is_borrowed and not job.is_done for job in work.jobs):
                raise DataError(
                    "a block was interrupted, and again before the rest of its signals was saved: some of the plants "
                    "have had it, and others have not. Go on from a snapshot, or from a saved monitor"
                )
            self.do(work)
        self.work = None


__all__ = ["OUTPUTS", "UNDER_WAY", "Job", "Parts", "Work", "Worker"]
