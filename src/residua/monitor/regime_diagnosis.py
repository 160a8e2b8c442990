"""Outcome of a monitor that is switched by operating mode: one time line, with the mode that judged each sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.decide.alarm import Alarm
from residua.decide.statement import SHOWN_ALARMS, left_out_text, longest_alarms
from residua.monitor.diagnosis import Diagnosis
from residua.recording.clock import Clock
from residua.shown import Shown
from residua.words import counted


@dataclass(frozen=True, eq=False)
class RegimeAlarm:
    """One alarm, and the operating mode in which it was raised.

    Attributes
    ----------
    mode : str
    alarm : Alarm
    """

    mode: str
    alarm: Alarm


@dataclass(frozen=True, eq=False, repr=False)
class RegimeDiagnosis(Shown):
    """The result of a :class:`residua.RegimeMonitor` on a recording. Prints as a table.

    Attributes
    ----------
    time : ndarray, shape (T,)
        Seconds.
    mode : ndarray of int, shape (T,)
        The operating mode of each sample, as a number in ``modes``; -1 where a signal of the modes is missing.
    modes : tuple of str
        The modes that occur in the recording, those that are not judged included.
    judged : mapping of str to Diagnosis
        By name of the mode, the diagnosis of its own monitor, on the same times: nothing is decided outside the mode.
    unjudged : mapping of str to str
        The modes of the recording in which nothing is decided, and why.
    statistic : ndarray, shape (T,)
        In units of the threshold of the mode: an alarm is above 1. NaN where nothing is decided.
    decided, alarm : ndarray of bool, shape (T,)
        An alarm counts in the samples of its own mode.
    transient : ndarray of bool, shape (T,)
        Samples that are left out because the mode has just changed.
    source, origin : str
        Where the recording is from, and the moment that ``time`` counts from.
    notes : tuple of str
    """

    time: NDArray[np.float64]
    mode: NDArray[np.int64]
    modes: tuple[str, ...]
    judged: Mapping[str, Diagnosis]
    unjudged: Mapping[str, str]
    statistic: NDArray[np.float64]
    decided: NDArray[np.bool_]
    alarm: NDArray[np.bool_]
    transient: NDArray[np.bool_]
    source: str
    origin: str
    notes: tuple[str, ...]

    @property
    def alarms(self) -> tuple[RegimeAlarm, ...]:
        """The alarms of all modes in order of time; one that continues in another mode is raised there again."""
        every = [RegimeAlarm(name, alarm) for name, one in self.judged.items() for alarm in one.alarms]
        return tuple(sorted(every, key=lambda one: one.alarm.start))

    @property
    def main_alarm(self) -> RegimeAlarm | None:
        """The alarm with the most samples judged in its mode; ``None`` without one."""
        return max(self.alarms, key=self._judged_in, default=None)

    @property
    def onset(self) -> float | None:
        """The estimated beginning of the first alarm; ``None`` without one."""
        return min((one.alarm.onset for one in self.alarms), default=None)

    @property
    def named(self) -> tuple[tuple[str, ...], ...]:
        """The faults that explain the main alarm; empty without a named fault."""
        return self.main_alarm.alarm.named if self.main_alarm else ()

    @property
    def false_alarm_fraction(self) -> float:
        """Fraction of the decided samples that are in alarm (a false alarm rate on fault-free data)."""
        decided = int(self.decided.sum())
        return float((self.alarm & self.decided).sum() / decided) if decided else 0.0

    def _judged_in(self, one: RegimeAlarm) -> int:
        """Return the number of judged samples of an alarm, which persists through visits to other modes."""
        return int(np.count_nonzero(self.judged[one.mode].decided[one.alarm.start : one.alarm.stop]))

    def samples(self, name: str) -> int:
        """Return the number of samples of the recording in a mode."""
        return int(np.count_nonzero(self.mode == self.modes.index(name))) if name in self.modes else 0

    @property
    def not_judged(self) -> tuple[str, ...]:
        """Description of the spans without a decision, with the number of their samples."""
        lines = [
            f"not judged: {name} ({why}), {counted(self.samples(name), 'sample')}"
            for name, why in self.unjudged.items()
        ]
        unknown = int(np.count_nonzero(self.mode < 0))
        if unknown:
            lines.append(f"not judged: a signal of the modes is missing, {counted(unknown, 'sample')}")
        left_out = int(np.count_nonzero(self.transient))
        if left_out:
            lines.append(f"not judged: transients after changes of mode, {counted(left_out, 'sample')}")
        known = np.isin(self.mode, [self.modes.index(name) for name in self.judged])
        rest = int(np.count_nonzero(known & ~self.transient & ~self.decided))
        if rest:
            lines.append(
                f"not judged: filters settle after a change of mode, or values are missing, {counted(rest, 'sample')}"
            )
        return tuple(lines)

    def __str__(self) -> str:
        clock = Clock(self.origin, float(self.time[1] - self.time[0]) if len(self.time) > 1 else 1.0)
        lines = [f"{self.source or 'recording'}: {counted(len(self.time), 'sample')}, {int(self.decided.sum())} judged"]
        lines += [
            f"{name}: {counted(self.samples(name), 'sample')}, {int(one.decided.sum())} judged, "
            f"{counted(len(one.alarms), 'alarm')}"
            for name, one in self.judged.items()
        ]
        if not self.alarms:
            lines.append("no fault found" if self.decided.any() else "no decision")
        alarms = [one.alarm for one in self.alarms]
        for k, _ in longest_alarms(alarms, SHOWN_ALARMS):
            one = self.alarms[k - 1]
            until = "to the end" if one.alarm.ended is None else f"until {clock.at(one.alarm.ended)}"
            length, judged = one.alarm.stop - one.alarm.start, self._judged_in(one)
            part = f", {judged} of its {length} samples judged" if judged < length else ""
            lines.append(f"alarm {k}: raised {clock.at(one.alarm.raised)}, {until}, with {one.mode}{part}")
            lines += self.judged[one.mode].alarm_lines(one.alarm)
        lines += filter(None, [left_out_text(alarms, SHOWN_ALARMS)])
        return "\n".join([*lines, *self.not_judged, *self.notes])
