"""A monitor for a run: its channels, and the names and texts of the alarms of one plant from its rows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.alarm import Alarm
from residua.decide.isolation import Seen
from residua.errors import NotFittedError, SettingError
from residua.live.readings import Layout
from residua.live.records import state_from_bytes
from residua.monitor.alarms import alarms_of, explainer_of, with_beginnings, with_words
from residua.monitor.diagnosis import Diagnosis
from residua.monitor.fleet_block import fingerprint_of
from residua.monitor.fused import run_block
from residua.monitor.monitor import Monitor
from residua.monitor.outcome import Recorded, compared_outputs, diagnosis_from
from residua.monitor.running import Decisions, State, initial_state, joined_decisions
from residua.recording.clock import Clock
from residua.words import listing

#: The moment that dates count from.
EPOCH = "1970-01-01T00:00:00"
#: Rows that a plant remembers at least and at most, whatever the time is that is asked for.
LEAST_ROWS, MOST_ROWS = 500, 20_000
#: Samples between two looks at a standing alarm at least.
_LEAST_BETWEEN = 10


class WatchedModel:
    """A fitted monitor that watches plants.

    Parameters
    ----------
    name : str
        Of the model, for page and metrics.
    monitor : Monitor
    history : float
        Seconds of rows that are kept of each plant at least.

    Attributes
    ----------
    layout : Layout
    rows_kept : int
        Rows that are kept of each plant at least.
    apart : int
        Rows without an alarm after which an alarm is over: a later one is another.
    between : int
        Rows between two looks at a standing alarm at least.
    fingerprint : str
        Fingerprint, equal for monitors with equal answers.

    Raises
    ------
    NotFittedError
        If the monitor has no threshold.
    SettingError
        If the monitor is for recordings alone.
    """

    def __init__(self, name: str, monitor: Monitor, history: float = 3600.0) -> None:
        if not isinstance(monitor, Monitor):
            raise SettingError(f"{name}: only a residua.Monitor runs live, not a {type(monitor).__name__}")
        if not monitor.is_fitted:
            raise NotFittedError(f"{name}: this monitor has no threshold: fit it to fault-free data first")
        self.name, self.monitor = name, monitor
        self.spec, self.generator = monitor._specification(), monitor.generator
        plant, isolation, test = self.generator.plant, self.spec.isolation, self.spec.test
        self.layout = Layout(tuple(plant.inputs), tuple(plant.outputs), float(self.generator.dt))
        self.rows_kept = int(np.clip(math.ceil(history / self.layout.dt), LEAST_ROWS, MOST_ROWS))
        self.apart = max(1, isolation.samples, test.samples)
        self.between = max(_LEAST_BETWEEN, isolation.samples, test.samples)
        self.fingerprint = fingerprint_of(monitor)

    @property
    def longest_gap(self) -> int:
        """Number of rows after which a filter restarts, at which a gap is cut."""
        return self.spec.max_hold + 1

    def start(self) -> State:
        """Return the state of a plant before its first row."""
        return initial_state(self.spec, 1)

    def run(self, state: State, values: NDArray[np.float64]) -> State:
        """Return the state after rows of one plant."""
        return run_block(self.spec, state, values[None])[0]

    def alarm_content(self, alarm: Alarm, clock: Clock) -> dict[str, Any]:
        """Return the content of an event about an alarm."""
        isolation = self.spec.isolation
        statement = isolation.statement(alarm, clock, isolation.samples_to_be_sure(self.spec.test))
        out = alarm.to_dict(window=isolation.samples_to_be_sure(self.spec.test))
        return _finite(
            {
                "plant_name": self.generator.plant.name,
                "name": name_of(alarm),
                "sure": statement.confidence,
                "text": [statement.headline, *statement.sentences],
                **out,
            }
        )


class Judged:
    """Rows of one plant from an anchor on, with the decisions on them, equal to those of ``Monitor.run`` in every bit.

    Parameters
    ----------
    model : WatchedModel
    start : int
        The number of the first row.
    anchor : bytes or None
        The running state before it; ``None`` for the start.
    """

    def __init__(self, model: WatchedModel, start: int, anchor: bytes | None) -> None:
        self.model, self.start, self.stop = model, start, start
        self._state = model.start() if anchor is None else state_from_bytes(anchor, model.spec)
        self._parts: list[Decisions] = []
        self._times: list[NDArray[np.float64]] = []
        self._values: list[NDArray[np.float64]] = []

    def take(self, times: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        """Process rows."""
        if not len(times):
            return
        self._state, part = run_block(self.model.spec, self._state, values[None])
        self._parts = [joined_decisions([*self._parts, part])]
        self._times, self._values = [np.concatenate([*self._times, times])], [np.concatenate([*self._values, values])]
        self.stop += len(times)

    @property
    def last_time(self) -> float:
        """Time of the last row."""
        return float(self._times[0][-1])

    def alarms(self, since: float) -> tuple[Alarm, ...]:
        """Return the alarms, with words for those since a time; not dated, since that is slow."""
        spec, decisions = self.model.spec, self._parts[0].of(0)
        seen = Seen(
            self._times[0], decisions.residuals, decisions.tested, decisions.named, self.model.generator, spec.test
        )
        explainer = explainer_of(spec, self.model.generator, self.model.monitor._check)
        return with_words(alarms_of(seen, spec.isolation), seen.residuals, seen.tested.usable, explainer, spec, since)

    def dated(self, alarms: Sequence[Alarm], since: float) -> tuple[Alarm, ...]:
        """Return the alarms raised since a time, dated by the intervals of their beginnings."""
        decisions = self._parts[0].of(0)
        return with_beginnings(alarms, decisions.residuals, decisions.tested.usable, self._times[0], since)

    def diagnosis(self, dated: bool) -> Diagnosis:
        """Return the diagnosis of all rows."""
        model = self.model
        compared = compared_outputs(model.monitor.design)
        recorded = Recorded(self._times[0], self._values[0], "", EPOCH if dated else "", compared)
        decisions, filtered = self._parts[0].of(0), self._state.filter
        bounds = model.monitor._bounds
        check = model.monitor._check
        return diagnosis_from(decisions, recorded, model.spec, model.generator, filtered, 0, (), bounds, check)


def name_of(alarm: Alarm) -> str:
    """Return the faults to which an alarm is attributed, as text; empty if nobody is named."""
    return listing(" or ".join(group) for group in alarm.named)


def clock_of(dated: bool, dt: float) -> Clock:
    """Return the clock of a plant: UTC if its times are dates."""
    return Clock(EPOCH if dated else "", dt)


def _finite(value: Any) -> Any:
    """Return plain values with ``None`` in place of NaN and infinity, which JSON does not have."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_finite(one) for one in value]
    return value


__all__ = ["EPOCH", "Judged", "WatchedModel", "clock_of", "name_of"]
