"""Matching what a recording holds to what a plant needs: columns, time and step."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from residua.errors import DataError, SettingError
from residua.plant import Plant
from residua.recording.time_axis import REGULAR, find_time
from residua.recording.time_grid import NEAR, STEP_TOLERANCE
from residua.visible import MAX_ECHO, echo, listed

#: Columns that a message names at most, and among which a name is looked for that may be meant.
_LISTED, _COMPARED = 40, 1000


@dataclass(frozen=True)
class ReadOptions:
    """What a caller asked for."""

    plant: Plant | None
    time: str | None
    dt: float | None
    columns: Mapping[str, str] | Sequence[str] | None
    variable: str | None
    tolerance: float | None = None
    fill_gaps: bool = False
    dayfirst: bool | None = None
    time_format: str | None = None
    decimal: str = "."
    transpose: bool = False

    def __post_init__(self) -> None:
        """Check the requested columns."""
        if self.decimal not in (".", ","):
            raise SettingError(f"decimal must be '.' or ',', got {echo(self.decimal)}")
        if self.plant is not None and not isinstance(self.plant, Plant):
            raise SettingError(f"plant must be a residua.Plant, got {echo(self.plant)}")
        if self.dt is not None and not (isinstance(self.dt, (int, float, np.number)) and 0 < self.dt < np.inf):
            raise DataError(f"dt must be a positive step in seconds, got {echo(self.dt)}")
        if self.tolerance is not None and not 0 < self.tolerance < (0.5 if self.fill_gaps else np.inf):
            least = "between 0 and 0.5" if self.fill_gaps else "over 0"
            raise SettingError(f"tolerance is a fraction of the step {least}, got {echo(self.tolerance)}")

    @property
    def near(self) -> float:
        """Largest irregularity of the times, as a fraction of the step."""
        if self.tolerance is not None:
            return self.tolerance
        return NEAR if self.fill_gaps else REGULAR

    @property
    def step(self) -> float | None:
        """The step that the caller or the plant asks for."""
        return self.dt or (self.plant.dt if self.plant else 0.0) or None

    @property
    def gets_round_times(self) -> bool:
        """Whether rows are simply ``dt`` apart where a time column that nobody named says otherwise, or nothing."""
        return self.dt is not None and self.time is None and not self.fill_gaps

    @property
    def inputs(self) -> tuple[str, ...]:
        """Control inputs of the plant."""
        return self.plant.inputs if self.plant else ()

    @property
    def outputs(self) -> tuple[str, ...]:
        """Outputs of the plant."""
        return self.plant.outputs if self.plant else ()

    @property
    def matrix_names(self) -> Sequence[str] | None:
        """Names of a matrix's columns, where that is what ``columns`` gives."""
        if self.columns is None or isinstance(self.columns, Mapping):
            return None
        return (self.columns,) if isinstance(self.columns, str) else tuple(self.columns)

    def matched(self, names: Sequence[str], source: str) -> tuple[dict[str, str], str | None]:
        """Return the column of every channel, and the time column."""
        renamed = self.columns if isinstance(self.columns, Mapping) else {}
        channels = (*self.inputs, *self.outputs)
        for channel in renamed:
            if self.plant and channel not in channels:
                raise DataError(f"columns: the plant has no channel {echo(channel)}; it has {listed(channels)}")
        chosen = {channel: renamed.get(channel, channel) for channel in channels or renamed}
        clock = self.time or find_time(names, chosen.values())
        if not chosen:
            chosen = {name: name for name in names if name != clock and name}
        wanted = [*chosen.values(), *([clock] if clock else [])]
        absent = [name for name in wanted if name not in names]
        if absent:
            raise DataError(missing_columns(absent, names, source, matched=wanted))
        twice = [name for name in dict.fromkeys(wanted) if list(names).count(name) > 1]
        if twice:
            raise DataError(f"{source}: more than one column is called {echo(twice[0])}")
        if not chosen:
            raise DataError(f"{source}: there is no column with data")
        return chosen, clock


def missing_columns(absent: list[str], names: Sequence[str], source: str, *, matched: Sequence[str]) -> str:
    """Say which columns are missing, what of those that are matched to nothing may be meant, and what is there."""
    taken = set(matched)
    lowered = {name.lower(): name for name in names[:_COMPARED] if len(name) <= MAX_ECHO and name not in taken}
    parts = []
    for name in absent:
        near = difflib.get_close_matches(name.lower(), lowered, n=1)
        parts.append(echo(name) + (f" (did you mean {echo(lowered[near[0]])}?)" if near else ""))
    return (
        f"{source}: missing column{'s' * (len(absent) > 1)} {', '.join(parts)}; "
        f"there are: {listed([echo(name) for name in names[:_LISTED]])}; "
        "where names differ, give columns={channel: column} (--columns CHANNEL=COLUMN)"
    )


def settled_step(read: float | None, options: ReadOptions, source: str) -> float:
    """Return the step that times, caller and plant agree on."""
    asked, own = options.dt, options.plant.dt if options.plant else 0.0
    known = [
        (value, what)
        for value, what in ((read, "its times are"), (asked, "dt= says"), (own or None, "the plant is sampled at"))
        if value is not None
    ]
    if not known:
        raise DataError(
            f"{source}: no time column ('time', 't', 'timestamp') and the plant is not sampled: give dt= in "
            "seconds, or time= with the name of the column"
        )
    step, first = known[0]
    for value, what in known[1:]:
        if abs(value - step) > STEP_TOLERANCE * value:
            raise DataError(
                f"{source}: the steps do not agree: {first} {step:g} s apart, {what} {value:g} s; "
                "resample the recording, or discretize the plant at its step"
            )
    return float(own or step)
