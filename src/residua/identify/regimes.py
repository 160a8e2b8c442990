"""One residual generator for each operating mode, from fault-free recordings that named signals divide into modes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import runs
from residua.design import kalman_filter
from residua.design.core.brought import for_monitor
from residua.errors import AccuracyError, DataError, DesignError, ModelError, SettingError
from residua.identify.arx import ArxModel
from residua.identify.channel_facts import channel_facts
from residua.identify.identified_model import IdentifiedModel
from residua.identify.lagged_rows import KNOWN
from residua.identify.operating_modes import (
    Key,
    ModeSignals,
    ages,
    check_few_values,
    distinct,
    mode_signals,
    rows_in,
    transient_rows,
)
from residua.identify.principal_components import principal_components
from residua.identify.segments import Gathered, Names, Segment, checked_count, gather
from residua.shown import Shown
from residua.visible import echo, listed
from residua.words import counted


@dataclass(frozen=True, eq=False)
class OperatingMode:
    """One operating mode with a model.

    Attributes
    ----------
    key : tuple of float
        The value of each signal of the modes, or the number of its interval.
    name : str
        In words: ``"fan on = 1, heating = 0"``.
    design : object
        What a :class:`residua.Monitor` takes: what the method returned for this mode.
    samples : int
        Rows that it was made from.
    transient : int
        Rows after a change into this mode that are left out.
    still : tuple of str
        Channels that never moved in this mode, which the design does not look at.
    """

    key: Key
    name: str
    design: Any = field(repr=False)
    samples: int
    transient: int
    still: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class Regimes(Shown):
    """A design for each operating mode: :class:`residua.RegimeMonitor` runs them.

    Attributes
    ----------
    signals : ModeSignals
        The names of the signals of the modes, and the edges that divide them.
    modes : mapping of str to OperatingMode
        Those with a model, by name.
    without_model : mapping of str to str
        The modes that the recordings show and that have no model: why not, with the number of their rows.
    inputs, outputs : tuple of str
        All channels of the recordings, the signals of the modes included.
    dt : float
        Step in seconds.
    notes : tuple of str
    """

    signals: ModeSignals
    modes: Mapping[str, OperatingMode]
    without_model: Mapping[str, str]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dt: float
    notes: tuple[str, ...] = ()

    @property
    def generator(self) -> NoReturn:
        """There is none: each mode has a generator of its own.

        Raises
        ------
        ModelError
            Always.
        """
        raise ModelError(
            "each operating mode has a generator of its own: residua.RegimeMonitor(regimes) runs them all, "
            "residua.Monitor(regimes.modes[name].design) one of them"
        )

    def _headline(self) -> str:
        return f"{self._counts()} by {listed(self.signals.names)}"

    def _counts(self) -> str:
        out = counted(len(self.modes), "mode")
        return f"{out}, {len(self.without_model)} without a model," if self.without_model else out

    def __str__(self) -> str:
        lines = [
            f"{one.name}: {counted(one.samples, 'row')}, {one.transient} after a change left out"
            + (f"; {listed(one.still)} never moved, and {_is(one.still)} not looked at" if one.still else "")
            for one in self.modes.values()
        ]
        lines += [f"{name}: no model, {why}" for name, why in self.without_model.items()]
        return "\n".join([repr(self), *lines, *self.notes])


def _is(names: tuple[str, ...]) -> str:
    return "is" if len(names) == 1 else "are"


def regimes(
    recordings: Any,
    y: ArrayLike | None = None,
    *,
    by: Any,
    inputs: Names = None,
    outputs: Names = None,
    method: Callable[..., Any] = principal_components,
    transient: int | None = None,
    least: int | None = None,
    dt: float | None = None,
) -> Regimes:
    r"""Return a residual generator for each operating mode of fault-free recordings, switched by named signals.

    .. math:: r_k = r_k^{(m_k)}, \qquad m_k = (s^1_k, s^2_k, \dots)

    The mode :math:`m` is the joint value of the signals ``by``. Rows are divided by it, the rows after each change of
    mode left out as far as the change is felt in them, and the method makes a design from what is left of each mode.
    :class:`residua.RegimeMonitor` fits a test to each, and decides nothing in a mode that the recordings did not show.

    Guaranteed: a row is used for the design of its own mode, and of no other. The same bits when a channel has other
    units, as far as these differ by a power of two (for the methods of which that holds).

    Parameters
    ----------
    recordings : Recording, data frame, path, array, pair (u, y), or a list of these
        Fault-free; rows with a missing value are left out.
    y : array_like, shape (time, outputs), optional
    by : sequence of str, or mapping of str to (sequence of float or None)
        The signals of the modes, which are channels of the recordings with few values (numbers: on and off are 1 and
        0). A mapping has the values that divide a signal: ``{"heating": None, "fan speed": [0.05]}`` has a mode for
        each value of ``heating``, with a fan speed below 0.05, and from 0.05 on.
    inputs, outputs : sequence of str, optional
        Channels by name, in their own units; all columns when omitted. A signal of the modes without edges has one
        value in a mode, and is no channel of its design, wherever it is named.
    method : callable
        Makes a design from the rows of one mode: ``method(rows, inputs=names, outputs=names, dt=dt)`` with a list of
        pairs of arrays ``(u, y)``, such as :func:`principal_components`, :func:`parity_from_data`, or :func:`subspace`
        and :func:`arx` (of whose models the Kalman filter with sensor faults is taken). A ``lambda`` or
        :func:`functools.partial` has settings of the method.
    transient : int, optional
        Rows after a change into a mode that are left out, the same for all modes. When omitted, for each mode as many
        as are unlike the second halves of the visits to it: ages 0, 1, 2 to 3, 4 to 7 and so on, up to the first two
        of these in a row with less than twice the mean squared distance (by the covariance of the second halves);
        half of the longest visit at most.
    least : int, optional
        Rows that a mode needs for a design; ten for each channel, and at least 30, when omitted.
    dt : float, optional
        Step in seconds of arrays.

    Returns
    -------
    Regimes

    Raises
    ------
    DataError
        If a signal of the modes is no channel, no row is complete, or no mode has enough rows for a design.
    SettingError
        If a signal of the modes has more than 20 values and no edges, or an option is out of range.

    Notes
    -----
    Assumes: fault-free recordings in which each mode is visited; the plant is the same whatever mode it came from, once
    the transient is over. A filter with a memory starts anew at each visit and settles besides. Where a mode was
    visited once or twice, a slow drift over the visit looks like a transient, and more is left out than need be: name
    ``transient`` then.

    See Also
    --------
    residua.RegimeMonitor : fits and runs what this makes.
    residua.identify.principal_components : the method when none is named.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> rng = np.random.default_rng(0)
    >>> heating = np.repeat([0.0, 1, 0, 1], 300)
    >>> air = rng.standard_normal(1200)
    >>> supply = air + 10 * heating + 0.1 * rng.standard_normal(1200)
    >>> rows = np.column_stack([heating, air, supply])
    >>> made = rs.identify.regimes(rows, outputs=["heating", "air", "supply"], by=["heating"])
    >>> made
    Regimes(2 modes by heating)
    >>> list(made.modes)
    ['heating = 0', 'heating = 1']
    """
    if not callable(method):
        raise SettingError(
            f"method must be a function such as residua.identify.principal_components, got {echo(method)}"
        )
    wait = None if transient is None else checked_count(transient, "transient")
    enough = None if least is None else checked_count(least, "least", 2)
    signals = mode_signals(by)
    if outputs is not None and not isinstance(recordings, np.ndarray) and y is None:
        listed_outputs = (outputs,) if isinstance(outputs, str) else tuple(outputs)
        known = {*listed_outputs, *((inputs,) if isinstance(inputs, str) else inputs or ())}
        outputs = (*listed_outputs, *(name for name in signals.names if name not in known))
    gathered = gather(recordings, y, inputs=inputs, outputs=outputs, dt=dt)
    visited = _Visited.of(gathered, signals)
    modes: dict[str, OperatingMode] = {}
    without: dict[str, str] = {}
    for key in distinct(visited.keys.values()):
        name = signals.label(key)
        made = _mode(visited, key, name, method, wait, enough)
        if isinstance(made, str):
            without[name] = made
        else:
            modes[name] = made
    if not modes:
        reasons = "; ".join(f"{name}: {why}" for name, why in without.items())
        raise DataError(f"no operating mode has a model: {reasons}")
    return Regimes(signals, modes, without, gathered.inputs, gathered.outputs, gathered.dt, gathered.notes)


@dataclass(frozen=True, eq=False)
class _Visited:
    """Recordings with the mode and its age in every row, complete or not."""

    gathered: Gathered
    signals: ModeSignals
    keys: Mapping[int, NDArray[np.float64]]
    ages: Mapping[int, NDArray[np.int64]]

    @staticmethod
    def of(gathered: Gathered, signals: ModeSignals) -> _Visited:
        absent = [name for name in signals.names if name not in gathered.channels]
        if absent:
            raise DataError(
                f"by: there is no channel {listed(absent)}; there are {listed(gathered.channels)} "
                "(columns of arrays have the names that inputs= and outputs= say)"
            )
        place = [gathered.channels.index(name) for name in signals.names]
        rows = {}
        for one in gathered.segments:
            if one.recording not in rows:
                whole = replace(one, start=0, stop=len(one.y))
                rows[one.recording] = whole.rows(0, len(one.y))[:, place]
        check_few_values(signals, list(rows.values()))
        keys = {number: signals.keys(one) for number, one in rows.items()}
        return _Visited(gathered, signals, keys, {number: ages(one) for number, one in keys.items()})

    def parts(self, key: Key, transient: int) -> list[Segment]:
        """Return the runs of complete rows in a mode, without what follows a change."""
        out = []
        for one in self.gathered.segments:
            here = rows_in(self.keys[one.recording], key) & (self.ages[one.recording] >= transient)
            out += [one.cut(start, stop) for start, stop in runs(here[one.start : one.stop]).tolist()]
        return out

    def entered(self, key: Key, columns: list[int]) -> list[NDArray[np.float64]]:
        """Return the visits to a mode that begin with a change, from their first row."""
        parts = self.parts(key, 0)
        whole = [one for one in parts if self.ages[one.recording][one.start] == 0 and len(one) > 1]
        return [one.rows(0, len(one))[:, columns] for one in whole]


def _mode(
    visited: _Visited, key: Key, name: str, method: Callable[..., Any], wait: int | None, enough: int | None
) -> OperatingMode | str:
    """Return the design for one mode; or why there is none."""
    gathered, signals = visited.gathered, visited.signals
    all_rows = gathered.with_segments(visited.parts(key, 0))
    if not all_rows.segments:
        return "no complete row"
    fixed = {one for one, edges in zip(signals.names, signals.edges, strict=True) if edges is None}
    candidates = [one for one in gathered.channels if one not in fixed]
    columns = [gathered.channels.index(one) for one in candidates]
    entered = visited.entered(key, columns)
    transient = wait if wait is not None else transient_rows(entered) if entered else 0
    settled = gathered.with_segments(visited.parts(key, transient))
    rows = settled.n_samples
    still = tuple(one for one in channel_facts(settled).constant() if one in candidates) if rows > 1 else ()
    moving = [one for one in candidates if one not in still]
    wanted = max(30, KNOWN * len(moving)) if enough is None else enough
    if rows < wanted:
        return f"{counted(rows, 'row')} of the {wanted} that it needs" + (
            f", {all_rows.n_samples - rows} more after changes" if transient else ""
        )
    ours = tuple(one for one in gathered.inputs if one in moving)
    theirs = tuple(one for one in gathered.outputs if one in moving)
    if not theirs:
        return f"none of {listed([one for one in gathered.outputs if one in candidates])} ever changes in {rows} rows"
    u = [gathered.channels.index(one) for one in ours]
    y = [gathered.channels.index(one) for one in theirs]
    pairs = [(data[:, u], data[:, y]) for data in settled.data()]
    try:
        made = method(pairs, inputs=ours or None, outputs=theirs, dt=gathered.dt)
        if isinstance(made, (ArxModel, IdentifiedModel)):
            made = kalman_filter(made.plant.with_sensor_faults())
    except (DataError, ModelError, DesignError, AccuracyError) as error:  # of this mode; the others may have a model
        return f"{counted(rows, 'row')}: {error}"
    return OperatingMode(key, name, for_monitor(made), rows, transient, still)
