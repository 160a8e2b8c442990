"""Matching a recording to the needs of a plant: columns, time and step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from residua.errors import DataError, SettingError
from residua.plant import Plant
from residua.recording.matching import matched_names, missing_columns, named_columns, spelling_notes
from residua.recording.missing import Marks
from residua.recording.time_axis import REGULAR, find_time
from residua.recording.time_grid import NEAR, STEP_TOLERANCE
from residua.visible import echo, listed


@dataclass(frozen=True)
class Matched:
    """Matched columns of a recording.

    Attributes
    ----------
    columns : dict of str to str
        Of each channel.
    clock : str or None
        The time column.
    notes : tuple of str
        The channels whose columns have another name.
    """

    columns: dict[str, str]
    clock: str | None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class ReadOptions:
    """Options of a caller."""

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
    missing: Sequence[str | float] | str = ()

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

    @cached_property
    def marks(self) -> Marks:
        """The marks of missing values."""
        more = (self.missing,) if isinstance(self.missing, (str, int, float)) else self.missing
        return Marks(tuple(str(mark) for mark in more))

    @property
    def near(self) -> float:
        """Largest allowed irregularity of the times, as a fraction of the step."""
        if self.tolerance is not None:
            return self.tolerance
        return NEAR if self.fill_gaps else REGULAR

    @property
    def step(self) -> float | None:
        """Step requested by the caller or the plant."""
        return self.dt or (self.plant.dt if self.plant else 0.0) or None

    @property
    def gets_round_times(self) -> bool:
        """True if rows are taken as ``dt`` apart, whatever an unnamed time column says."""
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
        """Names of a matrix's columns, if given by ``columns``."""
        if self.columns is None or isinstance(self.columns, Mapping):
            return None
        return (self.columns,) if isinstance(self.columns, str) else tuple(self.columns)

    @property
    def renamed(self) -> Mapping[str, str]:
        """Columns chosen by the caller for channels."""
        return self.columns if isinstance(self.columns, Mapping) else {}

    @property
    def takes_all(self) -> bool:
        """True if all columns with numbers are taken, since none was named."""
        return self.plant is None and not self.renamed and self.matrix_names is None

    def named_in(self, names: Sequence[str]) -> tuple[list[str], list[str]]:
        """Return the columns of the inputs, and of the outputs; the name of a channel if it has none."""
        found = matched_names((*self.inputs, *self.outputs), names, renamed=self.renamed)
        return [found.get(name, name) for name in self.inputs], [found.get(name, name) for name in self.outputs]

    def matched(self, names: Sequence[str], source: str) -> Matched:
        """Return the column of every channel, and the time column."""
        channels = (*self.inputs, *self.outputs)
        for channel in self.renamed:
            if self.plant and channel not in channels:
                raise DataError(f"columns: the plant has no channel {echo(channel)}; it has {listed(channels)}")
        chosen = matched_names(channels or tuple(self.renamed), names, renamed=self.renamed)
        clock = self.time or find_time(names, chosen.values())
        if not chosen and not channels:
            chosen = {name: name for name in names if name != clock and name}
        wanted = [*chosen.values(), *([clock] if clock else [])]
        absent = {name: name for name in channels if name not in chosen}
        absent |= {name: column for name, column in chosen.items() if column not in names}
        if absent:
            raise missing_columns(absent, names, source, matched=wanted)
        if clock is not None and clock not in names:
            raise DataError(f"{source}: missing column {echo(clock)} for the time; there are: {named_columns(names)}")
        twice = [name for name in dict.fromkeys(wanted) if list(names).count(name) > 1]
        if twice:
            raise DataError(f"{source}: more than one column is called {echo(twice[0])}")
        if not chosen:
            raise DataError(f"{source}: there is no column with data")
        units = self.plant.units if self.plant else {}
        spelt = {name: column for name, column in chosen.items() if name not in self.renamed}
        return Matched(chosen, clock, spelling_notes(spelt, units))


def settled_step(read: float | None, options: ReadOptions, source: str, texts: Sequence[str] = ()) -> float:
    """Return the step common to times, caller and plant; ``texts``: columns that may hold dates."""
    requested, sampled = options.dt, options.plant.dt if options.plant else 0.0
    known = [
        (value, what)
        for value, what in (
            (read, "its times are"),
            (requested, "dt= says"),
            (sampled or None, "the plant is sampled at"),
        )
        if value is not None
    ]
    if not known:
        raise DataError(
            f"{source}: no time column ('time', 't', 'timestamp') and the plant is not sampled: give dt= in "
            f"seconds, or time= with the name of the column{f' (text is in {named_columns(texts)})' if texts else ''}"
        )
    step, first = known[0]
    for value, what in known[1:]:
        if abs(value - step) > STEP_TOLERANCE * value:
            raise DataError(
                f"{source}: the steps do not agree: {first} {step:g} s apart, {what} {value:g} s; "
                "resample the recording, or discretize the plant at its step"
            )
    return float(sampled or step)
