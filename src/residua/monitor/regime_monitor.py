"""One monitor for each operating mode, the switch between them, and its result: one time line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import runs
from residua.decide.alarm import Alarm
from residua.decide.isolation import IsolationSettings
from residua.decide.statement import SHOWN_ALARMS, left_out_text, longest_alarms
from residua.decide.test import TestSettings
from residua.errors import DataError, FileFormatError, ModelError
from residua.files import read_bytes, write_text
from residua.identify.regimes import OperatingMode, Regimes, ages, distinct, mode_signals, rows_in
from residua.json_files import CHECKSUM, check_checksum, dumps, loads
from residua.monitor.diagnosis import Diagnosis
from residua.monitor.fault_learning import intervals_of
from residua.monitor.inputs import Signals, several_signals, signals
from residua.monitor.monitor import Monitor
from residua.monitor.saving import EDITED, REGIMES, monitor_from, monitor_out, read_content
from residua.number_kinds import POSITIVE
from residua.plant import Plant
from residua.recording.clock import Clock
from residua.recording.time_axis import REGULAR
from residua.records import RecordOf, joined, record, table_in, text_in, values_in, values_out
from residua.shown import Shown, notes, table
from residua.visible import echo, listed
from residua.words import counted

#: Of files.
VERSION = 1
#: Remark on a mode that no recording showed.
NEVER_SEEN = "a mode never seen"
#: Steps of a recording and of the monitor may differ by that part, as for a :class:`residua.Monitor`.
SAME_STEP = REGULAR / 10


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


class RegimeMonitor(Shown):
    """Watches recorded data for faults by one monitor for each operating mode.

    A sample is judged by the monitor of its own mode. Nothing is decided in a mode without a model, where a signal
    of the modes is missing, over the transient after a change of mode (:attr:`OperatingMode.transient
    <residua.identify.OperatingMode>`), nor until the filter of the mode has settled after it: it restarts at
    every visit, and after every missing value; a window of the test goes on with the last judged samples of earlier
    visits. What the recording holds of these is said in the diagnosis, with the numbers of samples. Each monitor
    has the false alarm rate that was asked for, so all together have it too.

    Parameters
    ----------
    regimes : Regimes
        From :func:`residua.identify.regimes`.
    test : TestSettings, optional
        When to raise an alarm, in every mode; by default the test of each design (:class:`residua.Monitor`).
    isolate : IsolationSettings, None or "auto"
        How to name the fault, as in :class:`residua.Monitor`.
    settle : int, optional
        Samples after the transient in which nothing is decided; by the slowest pole of each filter when omitted.

    Attributes
    ----------
    monitors : mapping of str to Monitor
        By name of the mode. They see NaN wherever another mode is.
    unfitted : mapping of str to str
        The modes whose monitor the last fit could not fit, and why.

    Notes
    -----
    It runs whole recordings; live samples (``step``) are for :class:`residua.Monitor`. A page on one mode:
    ``diagnosis.judged[name].to_html(path)``.

    See Also
    --------
    residua.identify.regimes : makes the designs.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> rng = np.random.default_rng(0)
    >>> def recorded(heating):
    ...     air = rng.standard_normal(len(heating))
    ...     supply = air + 10 * heating + 0.1 * rng.standard_normal(len(heating))
    ...     return np.column_stack([heating, air, supply])
    >>> normal = recorded(np.repeat([0.0, 1, 0, 1], 300))
    >>> made = rs.identify.regimes(normal, outputs=["heating", "air", "supply"], by=["heating"])
    >>> monitor = rs.RegimeMonitor(made).fit(None, recorded(np.repeat([0.0, 1, 0, 1], 300)))
    >>> new = recorded(np.repeat([0.0, 1, 2], 100))
    >>> new[150:200, 2] += 3.0
    >>> diagnosis = monitor.run(None, new)
    >>> diagnosis.named, diagnosis.onset
    ((('supply sensor',),), 150.0)
    >>> diagnosis.not_judged[0]
    'not judged: heating = 2 (a mode never seen), 100 samples'
    """

    def __init__(
        self,
        regimes: Regimes,
        *,
        test: TestSettings | None = None,
        isolate: IsolationSettings | str | None = "auto",
        settle: int | None = None,
    ) -> None:
        if not isinstance(regimes, Regimes):
            raise ModelError(f"expected what residua.identify.regimes returns, got {type(regimes).__name__}")
        self.regimes = regimes
        self.monitors: dict[str, Monitor] = {
            name: Monitor(one.design, test=test, isolate=isolate, settle=settle, max_hold=0)
            for name, one in regimes.modes.items()
        }
        self.unfitted: dict[str, str] = {}

    @classmethod
    def of(cls, regimes: Regimes, monitors: Mapping[str, Monitor], unfitted: Mapping[str, str]) -> RegimeMonitor:
        """Return the switch between existing monitors, one for each mode.

        Parameters
        ----------
        regimes : Regimes
        monitors, unfitted : mapping of str
            By name of the mode: the attributes of the same name.

        Returns
        -------
        RegimeMonitor

        Raises
        ------
        ModelError
            If there is not a monitor for each mode.
        """
        if set(monitors) != set(regimes.modes):
            raise ModelError(
                f"there are monitors for {listed(tuple(monitors)) or 'no mode'}, and the modes are "
                f"{listed(tuple(regimes.modes))}: give one for each"
            )
        made = cls.__new__(cls)
        made.regimes, made.monitors, made.unfitted = regimes, dict(monitors), dict(unfitted)
        return made

    @property
    def channels(self) -> tuple[str, ...]:
        """Inputs, then outputs, of its recordings."""
        return self.regimes.inputs + self.regimes.outputs

    @property
    def is_fitted(self) -> bool:
        """True if some mode has a threshold."""
        return any(one.is_fitted for one in self.monitors.values())

    def fit(
        self,
        u: Any,
        y: ArrayLike | None = None,
        *,
        time: ArrayLike | None = None,
        dt: float | None = None,
        false_alarm_rate: float | None = None,
        held_out: float = 0.2,
        force: bool = False,
    ) -> RegimeMonitor:
        """Fit the monitor of every mode to its rows of one or several fault-free recordings.

        Parameters
        ----------
        u, y, time, dt
            As for :meth:`residua.Monitor.fit`: with the channels of the regimes, the signals of the modes included, by
            name or, of arrays, in the same columns.
        false_alarm_rate, held_out : float
        force : bool
            As for :meth:`residua.Monitor.fit`, in every mode.

        Returns
        -------
        RegimeMonitor
            Itself.

        Raises
        ------
        DataError
            If a channel is missing, or no mode can be fitted. A mode that cannot is judged no more: ``unfitted``.
        """
        parts = [self._matched(one) for one in several_signals(u, y, time, dt, self._plant())]
        keys = [self._keys(one) for one, _ in parts]
        old = [ages(one) for one in keys]
        unfitted: dict[str, str] = {}
        fitted: dict[str, Monitor] = {}
        for name, mode in self.regimes.modes.items():
            monitor = self.monitors[name]
            own = [self._own(mode, *one) for one in zip(keys, old, strict=True)]
            pairs = [
                self._split(mode, rows, mine)
                for (rows, _), mine in zip(parts, own, strict=True)
                if _longest(mine) > monitor.settling_samples
            ]
            if not pairs:
                unfitted[name] = f"no visit of more than {monitor.settling_samples} settled samples to fit it to"
                continue
            try:
                fitted[name] = monitor.fit(pairs, false_alarm_rate=false_alarm_rate, held_out=held_out, force=force)
            except DataError as error:
                unfitted[name] = f"not fitted: {error}"
        if not fitted:
            raise DataError(f"no mode can be fitted: {'; '.join(f'{name}: {why}' for name, why in unfitted.items())}")
        self.unfitted = unfitted
        return self

    def run(
        self,
        u: Any,
        y: ArrayLike | None = None,
        *,
        time: ArrayLike | None = None,
        dt: float | None = None,
        source: str = "",
    ) -> RegimeDiagnosis:
        """Run over a whole recording, each sample by the monitor of its mode.

        Parameters
        ----------
        u, y, time, dt, source
            As for :meth:`residua.Monitor.run`, of one plant; the channels as for :meth:`fit`.

        Returns
        -------
        RegimeDiagnosis

        Raises
        ------
        DataError
            If a channel is missing, or the step is another.
        NotFittedError
            If the monitor of a mode that occurs has no threshold yet.
        """
        if y is not None and np.ndim(y) == 3:
            raise DataError("a monitor by operating mode takes one plant: (time, channels)")
        rows, measured = self._matched(signals(u, y, time, dt, source, self._plant()))
        keys = self._keys(rows)
        old, label = ages(keys), self.regimes.signals.label
        here = distinct([keys])
        clock = np.arange(len(rows), dtype=np.float64) * self.regimes.dt if measured.time is None else measured.time
        modes = tuple(label(key) for key in here)
        number = np.full(len(rows), -1)
        judged: dict[str, Diagnosis] = {}
        unjudged: dict[str, str] = {}
        transient = np.zeros(len(rows), dtype=bool)
        for k, (key, name) in enumerate(zip(here, modes, strict=True)):
            in_mode = rows_in(keys, key)
            number[in_mode] = k
            why = self._why_not(name)
            if why:
                unjudged[name] = why
                continue
            mode = self.regimes.modes[name]
            transient |= in_mode & (old < mode.transient)
            own, monitor = self._own(mode, keys, old), self.monitors[name]
            pair = self._split(mode, rows, own)
            one = monitor._judge(Signals(*pair, clock, self.regimes.dt, measured.source), own=own)
            assert isinstance(one, Diagnosis)
            recording = replace(one.recording, origin=measured.origin)
            judged[name] = replace(one, recording=recording, notes=(*one.notes, *_still(mode)))
        return _joined(clock, number, modes, judged, unjudged, transient, measured)

    def learn_fault(
        self,
        name: str,
        u: Any,
        y: ArrayLike | None = None,
        *,
        interval: Any = None,
        time: ArrayLike | None = None,
        dt: float | None = None,
    ) -> dict[str, str]:
        """Learn a fault from labelled recordings of it, in every mode in which they show it.

        Parameters
        ----------
        name, u, y, interval, time, dt
            As for :meth:`residua.Monitor.learn_fault`; the channels as for :meth:`fit`. Each mode learns from its own
            rows of the interval.

        Returns
        -------
        dict of str to str
            The modes that did not learn it, and why; empty when all did.

        Raises
        ------
        DataError
            If no mode learns it.
        """
        parts = [self._matched(one) for one in several_signals(u, y, time, dt, self._plant())]
        keys = [self._keys(rows) for rows, _ in parts]
        old = [ages(one) for one in keys]
        spans = [self._rows_of(*one) for one in zip(intervals_of(interval, len(parts)), parts, strict=True)]
        why_not: dict[str, str] = {}
        for mode in self.regimes.modes.values():
            monitor = self.monitors[mode.name]
            if not monitor.is_fitted:
                why_not[mode.name] = self._why_not(mode.name) or "it has no threshold yet: fit it"
                continue
            own = [self._own(mode, *one) for one in zip(keys, old, strict=True)]
            shown = [k for k, (mine, span) in enumerate(zip(own, spans, strict=True)) if _any(mine, span)]
            if not shown:
                why_not[mode.name] = "no recording shows it in this mode"
                continue
            pairs = [self._split(mode, parts[k][0], own[k]) for k in shown]
            try:
                monitor.learn_fault(name, pairs, interval=None if interval is None else [spans[k] for k in shown])
            except DataError as error:
                why_not[mode.name] = str(error)
        if len(why_not) == len(self.regimes.modes):
            raise DataError(
                f"no mode learns {echo(name)}: {'; '.join(f'{mode}: {why}' for mode, why in why_not.items())}"
            )
        return why_not

    def save(self, path: str | Path) -> None:
        """Write the monitors of all modes and the switch between them as JSON.

        Parameters
        ----------
        path : str or Path
            The file appears whole or not at all.

        Raises
        ------
        FileFormatError
            If the folder does not exist.
        """
        content = {
            "format": REGIMES,
            "version": VERSION,
            "regimes": values_out(self.regimes, but=("modes",)),
            "modes": {
                name: values_out(mode, but=("name", "design")) | {"monitor": monitor_out(self.monitors[name])}
                for name, mode in self.regimes.modes.items()
            },
            "unfitted": dict(self.unfitted),
        }
        write_text(path, dumps(content))

    @staticmethod
    def load(path: str | Path) -> RegimeMonitor:
        """Read a monitor saved by :meth:`save`, with the same answers to the last bit.

        Parameters
        ----------
        path : str or Path

        Returns
        -------
        RegimeMonitor

        Raises
        ------
        FileFormatError
            If the file is not such a monitor, or an entry is invalid.
        """
        path = Path(path)
        content = loads(read_bytes(path, "monitor"), path.name)
        if content.get("format") != REGIMES:
            raise FileFormatError(f'{path.name} is not a monitor by operating mode (no "format": {REGIMES!r} in it)')
        monitor: RegimeMonitor = read_content(content, path.name, VERSION, lambda: _read(content))
        if not check_checksum(content, path.name):
            for one in monitor.monitors.values():
                one.notes = (*one.notes, EDITED)
        return monitor

    # ------------------------------------------------------------------ helpers

    def _plant(self) -> Plant:
        """Return the channels as a plant, for matching measurements."""
        m, p = len(self.regimes.inputs), len(self.regimes.outputs)
        return Plant(
            np.zeros((0, 0)),
            np.zeros((0, m)),
            np.zeros((p, 0)),
            np.zeros((p, m)),
            dt=self.regimes.dt,
            inputs=self.regimes.inputs,
            outputs=self.regimes.outputs,
            name="recorded channels",
        )

    def _matched(self, one: Signals) -> tuple[NDArray[np.float64], Signals]:
        """Return the rows of all channels."""
        m, p = len(self.regimes.inputs), len(self.regimes.outputs)
        y = np.asarray(one.y, dtype=float)
        u = np.zeros((len(y), 0)) if one.u is None else np.asarray(one.u, dtype=float)
        u, y = (a[:, None] if a.ndim == 1 else a for a in (u, y))
        if u.shape != (len(y), m) or y.shape != (len(y), p):
            raise DataError(
                f"u has shape {u.shape} and y {y.shape}; expected (time, {m}) and (time, {p}), the channels "
                f"{listed(self.channels)}"
            )
        if one.dt is not None and abs(one.dt - self.regimes.dt) > SAME_STEP * self.regimes.dt:
            raise DataError(
                f"the monitor runs at dt={self.regimes.dt:g} s, the recording has {one.dt:g} s: resample it"
            )
        return np.hstack([u, y]), one

    def _keys(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        names = self.regimes.signals.names
        return self.regimes.signals.keys(rows[:, [self.channels.index(name) for name in names]])

    def _own(self, mode: OperatingMode, keys: NDArray[np.float64], old: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return the mask of rows for this mode to judge."""
        return rows_in(keys, mode.key) & (old >= mode.transient)

    def _split(
        self, mode: OperatingMode, rows: NDArray[np.float64], own: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return inputs and outputs of the plant of a mode, NaN in rows that it does not judge."""
        plant = self.monitors[mode.name].design.plant
        rows = np.where(own[:, None], rows, np.nan)
        u, y = ([self.channels.index(name) for name in group] for group in (plant.inputs, plant.outputs))
        return rows[:, u], rows[:, y]

    def _rows_of(self, interval: Any, part: tuple[NDArray[np.float64], Signals]) -> NDArray[np.bool_] | None:
        """Return the mask of rows in an interval; a mask unchanged."""
        rows, measured = part
        if not isinstance(interval, tuple):
            return interval
        clock = np.arange(len(rows)) * self.regimes.dt if measured.time is None else measured.time
        return (clock >= interval[0]) & (clock < interval[1])

    def _why_not(self, name: str) -> str:
        """Describe why a mode is not judged; empty for one that is."""
        if name in self.regimes.without_model:
            return f"no model: {self.regimes.without_model[name]}"
        if name not in self.regimes.modes:
            return NEVER_SEEN
        return self.unfitted.get(name, "")

    def _headline(self) -> str:
        state = "fitted" if self.is_fitted else "not fitted"
        return f"{len(self.monitors)} modes by {listed(self.regimes.signals.names)}, {state}"

    def _parts(self) -> list[str]:
        rows = [(name, one._headline()) for name, one in self.monitors.items()]
        return [table(["mode", "monitor"], rows), notes(f"{name}: {why}" for name, why in self.unfitted.items())]


def _any(own: NDArray[np.bool_], span: NDArray[np.bool_] | None) -> bool:
    """Tell whether any own row is in a span; ``None`` spans all rows."""
    return bool((own if span is None else own & span).any())


def _longest(own: NDArray[np.bool_]) -> int:
    """Return the largest number of consecutive own rows."""
    return int(np.diff(runs(own)).max(initial=0))


def _still(mode: OperatingMode) -> tuple[str, ...]:
    """Return a remark on channels that are ignored because they never moved."""
    if not mode.still:
        return ()
    return (f"not looked at, because they never moved in this mode when it was learnt: {listed(mode.still)}",)


def _joined(
    time: NDArray[np.float64],
    number: NDArray[np.int64],
    modes: tuple[str, ...],
    judged: Mapping[str, Diagnosis],
    unjudged: Mapping[str, str],
    transient: NDArray[np.bool_],
    measured: Signals,
) -> RegimeDiagnosis:
    statistic = np.full(len(time), np.nan)
    decided, alarm = np.zeros(len(time), dtype=bool), np.zeros(len(time), dtype=bool)
    notes: list[str] = []
    for name, one in judged.items():
        statistic[one.decided] = one.statistic[one.decided] / one.threshold
        decided |= one.decided
        alarm |= one.alarm & (number == modes.index(name))  # it stands on while other modes are judged by others
        notes += [f"with {name}: {note}" for note in one.notes if note not in measured.notes]
    return RegimeDiagnosis(
        time,
        number,
        modes,
        judged,
        unjudged,
        statistic,
        decided,
        alarm,
        transient,
        measured.source,
        measured.origin,
        (*measured.notes, *notes),
    )


def _read(content: Mapping[str, Any]) -> RegimeMonitor:
    """Return the monitor of a file; the caller checks the checksum."""
    content = record(content, "", ("format", "version", "regimes", "modes", "unfitted", CHECKSUM))
    regimes: Regimes = values_in(
        content["regimes"], "regimes", Regimes, {"modes": {}}, others=(RecordOf(Regimes, {"dt": POSITIVE}),)
    )
    signals = mode_signals(dict(zip(regimes.signals.names, regimes.signals.edges, strict=True)))
    channels = regimes.inputs + regimes.outputs
    absent = [name for name in signals.names if name not in channels]
    if absent:
        raise FileFormatError(f"regimes.signals: {listed(absent)} is not among the inputs and outputs")
    modes: dict[str, OperatingMode] = {}
    monitors: dict[str, Monitor] = {}
    for name, entry in table_in(content["modes"], "modes").items():
        where = joined("modes", name)
        values = table_in(entry, where)
        inner = joined(where, "monitor")
        monitor = monitor_from({**table_in(values.pop("monitor", None), inner), CHECKSUM: None}, inner)
        mode: OperatingMode = values_in(values, where, OperatingMode, {"name": name, "design": monitor.design})
        if len(mode.key) != len(signals.names) or signals.label(mode.key) != name:
            raise FileFormatError(f"{where}.key is not that of this mode")
        plant = monitor.design.plant
        foreign = [c for c in (*plant.inputs, *plant.outputs) if c not in channels]
        if foreign or abs(monitor.generator.dt - regimes.dt) > SAME_STEP * regimes.dt:
            raise FileFormatError(
                f"{inner}: its channels must be among the inputs and outputs, and its step {regimes.dt:g} s; got "
                f"{listed(foreign) if foreign else f'{monitor.generator.dt:g} s'}"
            )
        modes[name], monitors[name] = mode, monitor
    unfitted = {
        name: text_in(text, f"unfitted.{name}") for name, text in table_in(content["unfitted"], "unfitted").items()
    }
    return RegimeMonitor.of(replace(regimes, signals=signals, modes=modes), monitors, unfitted)
