"""The plants of a fleet that share a monitor: one contiguous block of state, a row for each plant."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.alarm import Candidate
from residua.decide.persistence import AlarmRuns
from residua.errors import DataError
from residua.monitor.decision import Decision, decision_from
from residua.monitor.fused import OUTPUTS, FusedRun, Job, LastSample, decisions_of, plan_of, with_starts
from residua.monitor.monitor import Monitor
from residua.monitor.online import UNDER_WAY
from residua.monitor.plant_records import as_records, mapped, rows_of, stacked_plants, written_rows
from residua.monitor.running import Decisions, State, initial_state, run_reference
from residua.monitor.saving import monitor_out
from residua.monitor.skipped_samples import SkippedSamples
from residua.visible import echo

#: Outputs of a tick.
_TICK = ("missing", "usable", "statistic", "alarm")


@dataclass(frozen=True)
class FleetAlarm:
    """An alarm standing at one plant of a fleet.

    Attributes
    ----------
    plant : object
        Its id.
    onset, raised : float
        When the statistic went over its threshold and stayed, and when the alarm was raised, in seconds since the first
        sample of this plant.
    candidates : tuple of Candidate
        Best first, by the last sample.
    """

    plant: Hashable
    onset: float
    raised: float
    candidates: tuple[Candidate, ...]

    def __str__(self) -> str:
        named = self.candidates[0].name if self.candidates else "unknown fault"
        return f"{self.plant}: {named}, alarm since {self.raised:g} s, onset {self.onset:g} s"


@dataclass(frozen=True)
class AlarmEvent:
    """An alarm that was raised at one plant of a fleet, or that has ended.

    Attributes
    ----------
    plant : object
        Its id.
    kind : {"raised", "ended"}
    onset_sample, raised_sample : int
        Numbers, among the samples of this plant, of the one at which the statistic went over its threshold and stayed,
        and of the one at which the alarm was raised.
    ended_sample : int or None
        Of the first one after the alarm; ``None`` in an event of an alarm that was raised.
    step : float
        Seconds between samples.
    candidates : tuple of Candidate
        Best first: by the sample at which the alarm was raised, or by the last one in alarm.
    """

    plant: Hashable
    kind: str
    onset_sample: int
    raised_sample: int
    ended_sample: int | None
    step: float
    candidates: tuple[Candidate, ...]

    @property
    def onset(self) -> float:
        """Onset in seconds since the sample with number 0."""
        return self.onset_sample * self.step

    @property
    def raised(self) -> float:
        """Time of raising in seconds since the sample with number 0."""
        return self.raised_sample * self.step

    @property
    def ended(self) -> float | None:
        """Time of ending in seconds since the sample with number 0; ``None`` if the alarm was only raised."""
        return None if self.ended_sample is None else self.ended_sample * self.step

    @property
    def sample(self) -> int:
        """Number of the sample of the event."""
        return self.raised_sample if self.ended_sample is None else self.ended_sample


class StandingAlarms:
    """Plants in alarm, with the onsets of their alarms.

    Parameters
    ----------
    plants : int
    alarms : iterable of (int, int, int)
        Rows in alarm, with the samples of its onset and of its raise.

    Attributes
    ----------
    stands : ndarray of bool, shape (plants,)
    onset, raised : ndarray of int, shape (plants,)
        Where an alarm stands.
    """

    def __init__(self, plants: int, alarms: Iterable[tuple[int, int, int]] = ()) -> None:
        self.stands = np.zeros(plants, dtype=bool)
        self.onset, self.raised = (np.zeros(plants, dtype=np.int64) for _ in range(2))
        for row, onset, raised in alarms:
            self.stands[row], self.onset[row], self.raised[row] = True, onset, raised

    def __len__(self) -> int:
        return int(np.count_nonzero(self.stands))

    def table(self) -> NDArray[np.int64]:
        """Return row, onset and raise of each alarm, in the order of the rows."""
        rows = np.flatnonzero(self.stands)
        return np.stack([rows, self.onset[rows], self.raised[rows]], axis=1)

    def of(self, rows: NDArray[np.int64]) -> StandingAlarms:
        """Return the alarms of some plants."""
        part = StandingAlarms(0)
        part.stands, part.onset, part.raised = self.stands[rows], self.onset[rows], self.raised[rows]
        return part

    @staticmethod
    def joined(parts: Sequence[StandingAlarms]) -> StandingAlarms:
        """Return the alarms of several blocks as one."""
        whole = StandingAlarms(0)
        whole.stands, whole.onset, whole.raised = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("stands", "onset", "raised")
        )
        return whole

    def changed(
        self, rows: NDArray[np.int64] | None, alarm: NDArray[np.bool_]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the rows of plants whose alarm has just begun, and of those whose alarm has ended."""
        which = np.flatnonzero(alarm != (self.stands if rows is None else self.stands[rows]))
        who, now = which if rows is None else rows[which], alarm[which]
        return who[now], who[~now]

    def change(self, begun: NDArray[np.int64], onset: NDArray, raised: NDArray, ended: NDArray[np.int64]) -> None:
        """Note alarms that have begun and ended; the flags are set last, so that it may be repeated."""
        self.onset[begun], self.raised[begun] = onset, raised
        self.stands[ended] = False
        self.stands[begun] = True


@dataclass(frozen=True, eq=False)
class Tick:
    """Decisions on the records of a tick, in their order.

    Attributes
    ----------
    alarm, decided, missing : ndarray of bool, shape (records,)
    statistic : ndarray, shape (records,)
        NaN where nothing is decided.
    """

    alarm: NDArray[np.bool_]
    decided: NDArray[np.bool_]
    missing: NDArray[np.bool_]
    statistic: NDArray[np.float64]

    @staticmethod
    def of(out: Mapping[str, Any]) -> Tick:
        """Return the decisions from the outputs of a block of one sample."""
        return Tick(*(out[name][:, 0] for name in ("alarm", "usable", "missing", "statistic")))


class JobInNumPy:
    """A block in NumPy: what may raise an error changes nothing, and the rest may be done again.

    Parameters
    ----------
    compute : callable
        Returns all that changes.
    keep : callable
        Takes it, and writes it down.
    """

    is_borrowed = False

    def __init__(self, compute: Callable[[], Any], keep: Callable[[Any], object]) -> None:
        self._compute, self._keep, self._computed = compute, keep, None
        self.out: dict[str, Any] = {}
        self.then: list[Callable[[], object]] = []
        self.is_done = False

    @property
    def is_begun(self) -> bool:
        """True if anything may have changed."""
        return self._computed is not None

    def perform(self) -> None:
        """Do the rest."""
        if self.is_done:
            return
        if self._computed is None:
            self._computed = self._compute()
        self._keep(self._computed)
        for step in self.then:
            step()
        self.is_done = True

    def own(self) -> None:
        """Do nothing: the signals are no longer those of the caller."""

    def wait(self) -> None:
        """Do nothing: there are no threads."""


class Worker:
    """Does jobs that happen all or not at all, and finishes interrupted ones before anything else."""

    def __init__(self) -> None:
        self._jobs: Sequence[Job | JobInNumPy] = ()
        self._is_within = False

    def do(self, *jobs: Job | JobInNumPy) -> None:
        """Do all of some jobs.

        An error leaves nothing changed, or jobs of which :meth:`finish` does the rest.
        """
        try:
            self._jobs, self._is_within = jobs, True
            for job in jobs:
                job.perform()
            self._is_within = False
        except BaseException:
            self._is_within = False
            for job in jobs:
                job.own()
            raise
        self._jobs = ()

    def finish(self) -> None:
        """Finish interrupted jobs, if they changed anything.

        Raises
        ------
        DataError
            If they were interrupted so often that the signals are not there any longer, or are under way: a job has
            called what it is a job of.
        """
        jobs = self._jobs
        if not jobs:
            return
        if self._is_within:
            raise DataError(UNDER_WAY)
        for job in jobs:
            job.wait()  # an interruption may have come in the middle of this, too
        if any(job.is_begun for job in jobs):
            if any(job.is_borrowed and not job.is_done for job in jobs):
                raise DataError(
                    "a block was interrupted, and again before the rest of its signals was saved: some of the plants "
                    "have had it, and others have not. Go on from a snapshot, or from a saved monitor"
                )
            self.do(*jobs)
        self._jobs = ()


def fingerprint_of(monitor: Monitor) -> str:
    """Return the fingerprint of a monitor: the SHA-256 of all that determines its answers.

    It is made once for a specification: to write a monitor takes longer than to restore a few plants.
    """
    spec = monitor._specification()
    known = spec.__dict__.get("_fingerprint")
    if known is None:
        content = monitor_out(monitor)
        ran = {name: content[name] for name in sorted(content) if name not in ("state", "notes", "fit_check")}
        known = hashlib.sha256(json.dumps(ran, sort_keys=True).encode()).hexdigest()
        object.__setattr__(spec, "_fingerprint", known)
    return known


class FleetBlock:
    """Plants that share a monitor.

    Parameters
    ----------
    monitor : Monitor
        Fitted; its own state is not used.
    ids : sequence of hashable
    state : State, optional
        A row for each; the start when omitted.
    standing : StandingAlarms, optional
    skipped : SkippedSamples, optional
    """

    def __init__(
        self,
        monitor: Monitor,
        ids: Sequence[Hashable],
        state: State | None = None,
        standing: StandingAlarms | None = None,
        skipped: SkippedSamples | None = None,
    ) -> None:
        monitor._specification()  # the specification is made once for all blocks
        self.monitor = copy(monitor)  # as it is now: it may be fitted anew while the plants run
        self.monitor.reset()
        self.spec, self.generator, self.ids = self.monitor._specification(), self.monitor.generator, list(ids)
        self.rows = {plant: row for row, plant in enumerate(self.ids)}
        if len(self.rows) < len(self.ids):
            twice = next(plant for row, plant in enumerate(self.ids) if self.rows[plant] != row)
            raise DataError(f"the plant {echo(twice)} occurs twice")
        self.standing = StandingAlarms(len(self.ids)) if standing is None else standing
        self.skipped = SkippedSamples() if skipped is None else skipped
        #: Of a new block, as long as no sample of any plant was judged: none can be over its threshold.
        self._is_settling = state is None
        #: Blocks of one fleet share one.
        self.worker = Worker()
        #: Events of a block that was interrupted before they were returned.
        self._untold: list[AlarmEvent] = []
        self._place(initial_state(self.spec, len(self.ids)) if state is None else state)

    def _place(self, state: State) -> None:
        """Move a new state, one record for each plant, into the kernel."""
        plan, plants = plan_of(self.spec), len(self.ids)
        isolation = self.spec.isolation
        members = 0 if isolation.coding is None else len(isolation.coding.members)
        last = LastSample.blank(plants, self.generator.n_residuals, len(isolation.groups), members)
        self._state, self.last = as_records([state, last]) if plants else (state, last)
        if self._is_settling:
            self._state = with_starts(self.spec, self._state)
        self._run: FusedRun | None = None
        if plan is not None and plan.names:
            self._run = FusedRun(self.spec, plan, self._state, len(self.generator.plant.inputs), self.last)
        #: Samples since there is room for starts, and after how many of each plant to look whether these are over.
        self._samples, self._starts = 0, 1 if self.spec.first is None else self.spec.first.samples + 1
        #: In NumPy: the decisions that hold the last sample of each plant, and where in them.
        self._made, self._place_in_made = np.empty(plants, dtype=object), np.zeros(plants, dtype=np.int64)
        self._looked_up: tuple[Any, NDArray[np.int64] | None] = (None, None)
        self._divided: tuple[NDArray[np.int64], list[NDArray[np.int64]]] | None = None

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the monitor."""
        return fingerprint_of(self.monitor)

    @property
    def state(self) -> State:
        """State of all plants, in the order of their ids."""
        self.finish()
        return self._now

    @property
    def _now(self) -> State:
        """State within a block."""
        return self._state if self._run is None else self._run.state

    def finish(self) -> None:
        """Finish an interrupted block, so that it happens whole."""
        self.worker.finish()

    # ----------------------------------------------------------------------- running

    def places(self, ids: Any) -> NDArray[np.int64] | None:
        """Return the rows of plants, ``None`` for all in order; the last list is cached."""
        if ids is self._looked_up[0] and ids is not None:
            return self._looked_up[1]
        if ids is None:
            return None
        keys = ids.tolist() if isinstance(ids, np.ndarray) else list(ids)
        if keys == self.ids:
            rows = None
        else:
            try:
                rows = np.fromiter(map(self.rows.__getitem__, keys), dtype=np.int64, count=len(keys))
            except KeyError as error:
                raise DataError(f"the fleet has no plant {echo(error.args[0])}: add([...]) it first") from error
        if isinstance(ids, tuple):  # nothing else is sure to be the same when it comes again
            self._looked_up = (ids, rows)
        return rows

    def tick(self, rows: NDArray[np.int64] | None, u: NDArray, y: NDArray, threads: int) -> Tick:
        """Process one sample of some plants; (records, channels). Records of one plant are applied in order."""
        self.finish()
        jobs, order = self.jobs_of_tick(rows, u, y, threads)
        self.worker.do(*jobs)
        return self.ticked(jobs, order)

    def jobs_of_tick(
        self, rows: NDArray[np.int64] | None, u: NDArray, y: NDArray, threads: int
    ) -> tuple[list[Job | JobInNumPy], NDArray[np.int64] | None]:
        """Return the jobs of a tick, and the places of its records in theirs; ``None`` for those of one job."""
        passes = self._passes_over(rows)
        if not passes or rows is None:
            return [self._job(rows, u[:, None], y[:, None], _TICK, threads, self._follow_alarms)], None
        samples = [(rows[which], u[which, None], y[which, None]) for which in passes]
        order = np.argsort(np.concatenate(passes), kind="stable")
        return [self._job(*one, _TICK, threads, self._follow_alarms) for one in samples], order

    @staticmethod
    def ticked(jobs: Sequence[Job | JobInNumPy], order: NDArray[np.int64] | None) -> Tick:
        """Return the decisions of the jobs of a tick once they are done."""
        first, *others = (Tick.of(job.out) for job in jobs)
        if order is None:
            return first
        return mapped(lambda *parts: np.concatenate(parts)[order], first, *others)

    def _passes_over(self, rows: NDArray[np.int64] | None) -> list[NDArray[np.int64]]:
        """Return passes over the records as :func:`_passes`; the last ids are cached."""
        if rows is None:
            return []
        known = self._divided
        if known is not None and known[0] is rows:
            return known[1]
        passes = _passes(rows, len(self.ids))
        self._divided = (rows, passes) if rows is self._looked_up[1] else None
        return passes

    def replace_state(self, rows: NDArray[np.int64], state: State) -> None:
        """Replace the states of some plants."""
        self.finish()
        if self._run is not None:
            self._run.write(rows, state)
        else:
            self._state = written_rows(self._state, rows, state)

    def advance(
        self, rows: NDArray[np.int64], data: NDArray[np.float64], names: Sequence[str], threads: int = 1
    ) -> dict[str, NDArray]:
        """Process a block of some plants, each once, (plants, time, channels); return some of the decisions."""
        self.finish()
        inputs = len(self.generator.plant.inputs)
        job = self._job(rows, data[..., :inputs], data[..., inputs:], names, threads)
        self.worker.do(job)
        return {name: job.out[name] for name in names}

    def _job(
        self,
        rows: NDArray[np.int64] | None,
        u: NDArray,
        y: NDArray,
        keep: Sequence[str],
        threads: int,
        follow: Callable[[NDArray[np.int64] | None, dict[str, Any]], object] | None = None,
    ) -> Job | JobInNumPy:
        """Return the job of a block of plants, each once; ``follow`` takes the decisions."""
        run = self._run
        if run is not None:
            job = Job(run, u, y, run.outputs(len(y), y.shape[1], keep), rows, threads=threads)
            job.then.append(lambda: self._after(y.shape[0] * y.shape[1]))
        else:
            job = self._job_in_numpy(rows, np.ascontiguousarray(np.concatenate([u, y], axis=2)), keep)
        if follow is not None:
            job.then.append(lambda: follow(rows, job.out))
        return job

    def _job_in_numpy(
        self, rows: NDArray[np.int64] | None, data: NDArray[np.float64], keep: Sequence[str]
    ) -> JobInNumPy:
        """Return the job of a block in NumPy."""
        places = np.arange(len(self.ids)) if rows is None else rows

        def write(made: tuple[State, Decisions]) -> None:
            after, decisions = made
            self._state = written_rows(self._state, places, after)
            if data.shape[1]:
                self.last.remember(places, decisions)
                self._made[places], self._place_in_made[places] = decisions, np.arange(len(places))
            job.out.update({name: getattr(decisions, name) for name in keep}, decisions=decisions)

        job = JobInNumPy(lambda: run_reference(self.spec, rows_of(self._now, places), data), write)
        return job

    def _after(self, samples: int) -> None:
        """Release the room for starts when they are over, checked less and less often."""
        run = self._run
        if run is None or not run.has_room_for_starts:
            return
        self._samples += samples
        if self._samples >= self._starts * len(self.ids):
            self._starts *= 2
            run.let_go_of_starts()

    def follow(self, rows: NDArray[np.int64], u: NDArray, y: NDArray, threads: int) -> list[AlarmEvent]:
        """Process a block, (plants, time, channels), of some plants, each once; return the alarms raised and ended."""
        if not y.shape[1]:
            return []
        self.finish()
        before, last, was = self._now.count[rows], self.last.scores[rows], self.standing.of(rows)
        untold = self._untold  # of a block that was interrupted

        def follow(_: Any, out: dict[str, Any]) -> None:
            self._untold = untold + self._events(rows, out, before, last, was)
            self._follow_skipped(rows, out["usable"])

        self.worker.do(self._job(rows, u, y, ("alarm", "up", "scores", "usable"), threads, follow))
        events, self._untold = self._untold, []
        return events

    def _events(
        self,
        rows: NDArray[np.int64],
        out: dict[str, Any],
        before: NDArray[np.int64],
        last: NDArray[np.float64],
        was: StandingAlarms,
    ) -> list[AlarmEvent]:
        """Record the alarms that some plants raised or ended in a block, given their earlier state, and return them."""
        alarm, usable, standing, events = out["alarm"], out["usable"], self.standing, []
        begins = {k: (int(was.onset[k]), int(was.raised[k])) for k in np.flatnonzero(was.stands).tolist()}
        for k, t in np.argwhere(alarm != np.concatenate([was.stands[:, None], alarm[:, :-1]], axis=1)).tolist():
            row, number = int(rows[k]), int(before[k]) + t
            if alarm[k, t]:
                one = np.array([k])
                onset = self.skipped.onsets(rows[one], before[one], usable[one, : t + 1], out["up"][one, t])
                begins[k] = (int(onset[0]), number)
                standing.stands[row], standing.onset[row], standing.raised[row] = True, *begins[k]
                events.append(self._event(row, begins[k], None, out["scores"][k, t]))
            else:
                scores = out["scores"][k, t - 1] if t else last[k]
                standing.stands[row] = False
                events.append(self._event(row, begins[k], number, scores))
        return events

    def _event(self, row: int, when: tuple[int, int], ended: int | None, scores: NDArray[np.float64]) -> AlarmEvent:
        kind, named = "raised" if ended is None else "ended", self.spec.isolation.candidates(scores)
        return AlarmEvent(self.ids[row], kind, *when, ended, self.generator.dt, named)

    def _follow_skipped(self, rows: NDArray[np.int64] | None, usable: NDArray[np.bool_]) -> None:
        """Record the samples of a block that were not judged, once the onsets of its alarms are known."""
        self._is_settling = self._is_settling and not usable.any()
        if self._is_settling:
            return
        which = np.flatnonzero(~(usable[:, 0] if usable.shape[1] == 1 else usable.all(axis=1)))
        if not which.size:
            return
        who = which if rows is None else rows[which]
        over = self.over(who)
        if over.any():
            self.skipped.note(who, self._now.count[who] - usable.shape[1], usable[which], over)

    def over(self, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the number of samples in a row over the threshold for plants without a standing alarm.

        Of a bank, the largest number of a member. Of a test that does not count them in its state, what it says of the
        last sample.
        """
        runs = getattr(self._now.test, "runs", None)
        if not isinstance(runs, AlarmRuns):
            return np.where(self.standing.stands[rows], 0, self.last.up[rows])
        over = np.where(runs.alarm[rows], 0, runs.up[rows])
        return over if over.ndim == 1 else over.max(axis=1, initial=0)

    def _follow_alarms(self, rows: NDArray[np.int64] | None, out: dict[str, Any]) -> None:
        """Record the alarms raised and ended by a sample of plants."""
        new, ended = self.standing.changed(rows, out["alarm"][:, 0])
        if new.size or ended.size:
            before, judged = self._now.count[new] - 1, np.ones((len(new), 1), dtype=bool)
            onset = self.skipped.onsets(new, before, judged, self.last.up[new])
            self.standing.change(new, onset, before, ended)
        self._follow_skipped(rows, out["usable"])

    def run(self, data: NDArray[np.float64], threads: int) -> Decisions:
        """Process a block of all plants, (plants, time, channels)."""
        self.finish()
        job = self.job_of_run(data, threads)
        self.worker.do(job)
        return job.out["decisions"]

    def job_of_run(self, data: NDArray[np.float64], threads: int) -> Job | JobInNumPy:
        """Return the job of a block of all plants, which leaves its decisions among its outputs."""
        before, inputs = self._now.count.copy(), len(self.generator.plant.inputs)

        def follow(_: Any, out: dict[str, Any]) -> None:
            if self._run is not None:
                out["decisions"] = decisions_of(out)
            if data.shape[1]:
                self._follow_block(out["decisions"], before)

        keep = () if self._run is None else OUTPUTS
        return self._job(None, data[..., :inputs], data[..., inputs:], keep, threads, follow)

    def _follow_block(self, decisions: Decisions, before: NDArray[np.int64]) -> None:
        """Record the standing alarms after a block."""
        alarm, standing = decisions.alarm, self.standing
        standing.stands &= np.asarray(alarm.all(axis=1))  # alarms that stood all the time still stand
        new, ended = standing.changed(None, alarm[:, -1])
        off = ~alarm[new, ::-1]
        raised = np.where(off.any(axis=1), alarm.shape[1] - off.argmax(axis=1), 0)
        onset = np.zeros(len(new), dtype=np.int64)
        for t in np.unique(raised).tolist():
            which = raised == t
            those = new[which]
            onset[which] = self.skipped.onsets(
                those, before[those], decisions.usable[those, : t + 1], decisions.up[those, t]
            )
        standing.change(new, onset, before[new] + raised, ended)
        self._follow_skipped(None, decisions.usable)

    # ----------------------------------------------------------------------- looking

    def decision(self, row: int) -> Decision:
        """Return the decision on the last sample of a plant."""
        if not self.state.count[row]:
            raise DataError(f"the plant {echo(self.ids[row])} has had no sample yet")
        state = rows_of(self.state, np.array([row]))
        if self._run is None and self._made[row] is not None:
            made = mapped(lambda array: array[:, -1:], rows_of(self._made[row], self._place_in_made[[row]]))
            return decision_from(made, self.spec, self.generator, state)
        one, flags = self.last, int(self.last.flags[row])
        alarm, usable, missing = (np.array([[bool(flags & bit)]]) for bit in (1, 2, 4))
        out: dict[str, Any] = {
            "alarm": alarm,
            "usable": usable,
            "missing": missing,
            "exceeded": alarm,
            "whitened": None,
        }
        out |= {"aside": np.zeros((1, 1, self.spec.B.shape[1]), dtype=bool), "up": one.up[[row], None]}
        out |= {"statistic": one.statistic[[row], None], "residuals": one.residuals[[row], None]}
        made = decisions_of(out | {"scores": one.scores[[row], None]})
        if self.spec.members:
            nobody = np.full((1, 1, len(self.spec.members)), np.nan)  # of a test in NumPy that is known with the next
            fired = state.test.arrays()[-1][:, None] if self.spec.test.compiled is not None else nobody > 0
            made = replace(made, tested=replace(made.tested, part_statistics=nobody, fired=fired))
        if one.code is not None:
            made = replace(made, named=replace(made.named, code=one.code[[row], None]))
        return decision_from(made, self.spec, self.generator, state)

    def alarms(self) -> list[FleetAlarm]:
        """Return the standing alarms, the oldest first."""
        self.finish()
        dt, isolation, scores, table = self.generator.dt, self.spec.isolation, self.last.scores, self.standing.table()
        return [
            FleetAlarm(self.ids[row], onset * dt, raised * dt, isolation.candidates(scores[row]))
            for row, onset, raised in table[np.argsort(table[:, 2], kind="stable")].tolist()
        ]

    # ------------------------------------------------------------------- other plants

    def of(self, rows: NDArray[np.int64]) -> FleetBlock:
        """Return a block of some of the plants, with its own state."""
        self.finish()
        ids = [self.ids[row] for row in rows]
        part = FleetBlock(self.monitor, ids, rows_of(self.state, rows), self.standing.of(rows), self.skipped.of(rows))
        part.take_over(rows_of(self.last, rows), self._made[rows], self._place_in_made[rows])
        part._untold = [event for event in self._untold if event.plant in part.rows]
        return part

    def take_over(self, last: LastSample, made: NDArray | None = None, places: NDArray | None = None) -> None:
        """Copy the decisions on the last sample of every plant."""
        written_rows(self.last, np.arange(len(self.ids)), last)
        if made is not None and places is not None:
            self._made, self._place_in_made = made.copy(), places.copy()

    @staticmethod
    def joined(parts: Sequence[FleetBlock]) -> FleetBlock:
        """Return blocks as one."""
        for part in parts:
            part.finish()
        first, standing = parts[0], StandingAlarms.joined([part.standing for part in parts])
        ids = [plant for part in parts for plant in part.ids]
        skipped = SkippedSamples.joined([(part.skipped, len(part.ids)) for part in parts])
        whole = FleetBlock(first.monitor, ids, stacked_plants([part.state for part in parts]), standing, skipped)
        made = np.concatenate([part._made for part in parts])
        places = np.concatenate([part._place_in_made for part in parts])
        whole.take_over(stacked_plants([part.last for part in parts]), made, places)
        whole._untold = [event for part in parts for event in part._untold]
        return whole


def _passes(rows: NDArray[np.int64], plants: int) -> list[NDArray[np.int64]]:
    """Return passes over the records, each with a plant at most once; empty for a single pass."""
    if len(rows) < 2 or np.bincount(rows, minlength=plants).max() == 1:
        return []
    order = np.argsort(rows, kind="stable")
    first = np.concatenate([[True], rows[order][1:] != rows[order][:-1]])
    begins = np.maximum.accumulate(np.where(first, np.arange(len(rows)), 0))
    number = np.empty(len(rows), dtype=np.int64)
    number[order] = np.arange(len(rows)) - begins
    return [np.flatnonzero(number == k) for k in range(int(number.max()) + 1)]


__all__ = ["AlarmEvent", "FleetAlarm", "FleetBlock", "StandingAlarms", "Tick", "Worker", "fingerprint_of"]
