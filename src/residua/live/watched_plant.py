"""State of one plant in a run, and its record in the store."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.live.events import ReportedAlarm
from residua.live.sampling import Rows, SamplingState

#: Rows of a plant that are kept at hand at least.
AT_HAND = 64
#: Steps of another length, and so many times those of the right one, from which on the plant has another step.
ODD_STEPS = 10


@dataclass(slots=True)
class Steps:
    """Steps between the readings of a plant, for comparison with the step of its monitor.

    Attributes
    ----------
    last : float
        The time of the last reading.
    right, wrong : int
        Steps that were those of the monitor, and others; repeats do not count.
    usual : float
        The last one of the others.
    """

    last: float = math.nan
    right: int = 0
    wrong: int = 0
    usual: float = math.nan

    def odd(self, times: Sequence[float] | NDArray[np.float64], dt: float) -> bool:
        """Record times of readings; return whether nearly all have another step."""
        step = float(times[0] - self.last if len(times) == 1 else times[1] - times[0])
        self.last = float(times[-1])
        if step > 0:
            if abs(step - dt) < dt / 4:
                self.right += 1
            else:
                self.wrong, self.usual = self.wrong + 1, step
        return self.wrong >= ODD_STEPS and self.wrong > ODD_STEPS * self.right


@dataclass(slots=True, eq=False)
class WatchedPlant:
    """State of one plant in a run, beside the running state of its monitor.

    Attributes
    ----------
    key : int
        Of its rows in the store.
    plant, model : str
    place : int
        Its row in the block of its model.
    count : int
        Rows so far.
    sampling : SamplingState
    number : int
        Of its last event.
    reported : list of ReportedAlarm
        Alarms that are not over.
    open_row : int
        The row that raised the first of them; -1 without any.
    open_since : float
        The time of that row.
    last_on, next_look : int
        The last row in alarm, and the row at which alarms are looked at next.
    gap, whole : int
        Rows in a row with a value missing, and without.
    missing : tuple of int, or None
        The channels that were reported to be missing; ``None`` while none are.
    anchor, mark : bytes or None
        Running states at the rows ``anchor_at``, from which on rows are kept, and ``mark_at``, where the anchor goes
        next; ``None``: the start.
    standing_at : int
        The row at which an alarm was reported to stand where the data end.
    running_at : int
        The row at which the store has the running state.
    attribution : tuple of (str, str, float), or None
        Of the alarm that was reported last: the faults it is put down to, how sure that is, and when it was raised.
    ratio : float
        Of the last row, statistic over threshold.
    heard : float
        When something came of it last, by a clock that only goes forward.
    steps : Steps
    recent : deque of Rows
        The last rows; ``recent_rows`` of them.
    """

    key: int
    plant: str
    model: str
    place: int = -1
    count: int = 0
    sampling: SamplingState = field(default_factory=SamplingState)
    number: int = 0
    reported: list[ReportedAlarm] = field(default_factory=list)
    open_row: int = -1
    open_since: float = 0.0
    last_on: int = -1
    next_look: int = 0
    gap: int = 0
    whole: int = 0
    missing: tuple[int, ...] | None = None
    anchor: bytes | None = None
    anchor_at: int = 0
    mark: bytes | None = None
    mark_at: int = 0
    standing_at: int = -1
    running_at: int = 0
    attribution: tuple[str, str, float] | None = None
    ratio: float = math.nan
    heard: float = 0.0
    steps: Steps = field(default_factory=Steps)
    recent: deque[Rows] = field(default_factory=deque)
    recent_rows: int = 0

    def remember(self, rows: Sequence[Rows]) -> None:
        """Keep the last rows at hand, for repeated readings."""
        for one in rows:
            self.recent.append(one)
            self.recent_rows += len(one.times)
        while len(self.recent) > 1 and self.recent_rows - len(self.recent[0].times) >= AT_HAND:
            self.recent_rows -= len(self.recent.popleft().times)

    def to_record(self) -> str:
        """Return the values that change with every row, as JSON, with NaN as such."""
        content: list[Any] = [self.count, self.number, self.open_row, self.open_since, self.last_on, self.next_look]
        content += [self.gap, self.whole, None if self.missing is None else list(self.missing)]
        content += [[one.to_record() for one in self.reported], self.sampling.to_record()]
        content.append(None if self.attribution is None else list(self.attribution))
        content += [self.standing_at, self.ratio]
        return json.dumps(content)

    def take_record(self, record: str, now: float) -> None:
        """Restore the values of :meth:`to_record`; pending readings count as having arrived at ``now``."""
        content = json.loads(record)
        self.count, self.number, self.open_row, self.open_since, self.last_on, self.next_look = content[:6]
        self.gap, self.whole, missing, reported, sampling, attribution, self.standing_at, self.ratio = content[6:]
        self.attribution = None if attribution is None else (attribution[0], attribution[1], attribution[2])
        self.missing = None if missing is None else tuple(missing)
        self.reported = [ReportedAlarm.from_record(one) for one in reported]
        self.sampling = SamplingState.from_record(sampling, now)
        self.heard = now
