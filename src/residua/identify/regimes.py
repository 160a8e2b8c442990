"""One residual generator for each operating mode, from fault-free recordings that named signals divide into modes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import runs
from residua.design import kalman_filter
from residua.design.core.generator import for_monitor
from residua.errors import AccuracyError, DataError, DesignError, ModelError, SettingError
from residua.identify.channel_facts import channel_facts
from residua.identify.channel_filter import KNOWN
from residua.identify.identified_model import RecordedModel
from residua.identify.principal_components import principal_components
from residua.identify.segments import Gathered, Names, Segment, checked_count, gather
from residua.shown import Shown
from residua.tolerances import DATA_ROUNDING
from residua.visible import echo, listed
from residua.words import counted

#: More different values than these are no modes but a quantity.
MOST_VALUES = 20
#: The age of a mode at the start of a recording: nobody knows how long it has lasted.
UNKNOWN_AGE = np.iinfo(np.int64).max
#: Mean squared distance from the settled rows, relative to that of these rows, from which on rows are unlike them.
_UNLIKE = 2.0

Key = tuple[float, ...]


@dataclass(frozen=True)
class ModeSignals:
    """The signals whose joint value is the operating mode.

    Attributes
    ----------
    names : tuple of str
    edges : tuple of (tuple of float or None)
        For each signal ``None``: each of its values is a mode of its own; or the values that divide it: a mode goes
        from one of them, included, to the next.
    """

    names: tuple[str, ...]
    edges: tuple[tuple[float, ...] | None, ...]

    def keys(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the mode of each row of these signals, shape (time, signals); NaN where one is missing."""
        keys = np.array(rows, dtype=float)
        keys[~np.isfinite(keys).all(axis=1)] = np.nan
        for j, edges in enumerate(self.edges):
            if edges is not None:
                here = np.isfinite(keys[:, j])
                keys[here, j] = np.searchsorted(edges, keys[here, j], side="right")
        return keys + 0.0  # no -0.0

    def label(self, key: Key) -> str:
        """Return a mode in words."""
        parts = []
        for name, value, edges in zip(self.names, key, self.edges, strict=True):
            k = int(value) if edges is not None else 0
            if edges is None:
                parts.append(f"{name} = {_text(value)}")
            elif k == 0:
                parts.append(f"{name} < {_text(edges[0])}")
            elif k == len(edges):
                parts.append(f"{name} >= {_text(edges[-1])}")
            else:
                parts.append(f"{_text(edges[k - 1])} <= {name} < {_text(edges[k])}")
        return ", ".join(parts)


def _text(value: float) -> str:
    """Return a number, with all digits where fewer are another one: two modes have two names."""
    short = f"{value:.10g}"
    return short if float(short) == value else repr(value)


def mode_signals(by: Any) -> ModeSignals:
    """Return the signals of modes, from a list of names or a mapping of names to edges.

    Raises
    ------
    SettingError
        If there is none, one is there twice, or edges are no increasing numbers.
    """
    if isinstance(by, str):
        by = [by]
    if not isinstance(by, Iterable):
        raise SettingError(f"by must name the signals of the modes, or map them to edges, got {echo(by)}")
    names = tuple(by)
    if not names or not all(isinstance(name, str) and name for name in names) or len(set(names)) < len(names):
        raise SettingError(f"by must name at least one signal, each once, got {echo(by)}")
    if not isinstance(by, Mapping):
        return ModeSignals(names, (None,) * len(names))
    borders: list[tuple[float, ...] | None] = []
    for name in names:
        if by[name] is None:
            borders.append(None)
            continue
        values = np.atleast_1d(np.asarray(by[name]))
        if values.dtype.kind not in "iuf" or values.ndim != 1 or not len(values) or not np.isfinite(values).all():
            raise SettingError(f"by: the edges of {echo(name)} must be numbers, or None, got {echo(by[name])}")
        if not (np.diff(values) > 0).all():
            raise SettingError(f"by: the edges of {echo(name)} must increase, got {echo(by[name])}")
        borders.append(tuple(float(value) for value in values))
    return ModeSignals(names, tuple(borders))


def distinct(keys: Iterable[NDArray[np.float64]]) -> list[Key]:
    """Return the modes that occur, sorted."""
    found = {tuple(row) for one in keys for row in np.unique(one[np.isfinite(one).all(axis=1)], axis=0).tolist()}
    return sorted(found)


def rows_in(keys: NDArray[np.float64], key: Key) -> NDArray[np.bool_]:
    """Return the mask of the rows in a mode."""
    return np.asarray((keys == np.array(key)).all(axis=1))


def ages(keys: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the number of rows that each row's mode has lasted; missing modes count as one mode.

    ``UNKNOWN_AGE`` for the mode at the start of a recording.
    """
    n = len(keys)
    filled = np.where(np.isnan(keys), np.inf, keys)
    changes = np.concatenate([[0], np.flatnonzero((filled[1:] != filled[:-1]).any(axis=1)) + 1]) if n else []
    start = np.zeros(n, dtype=np.int64)
    start[changes] = changes
    start = np.maximum.accumulate(start)
    out = np.arange(n) - start
    if n and np.isfinite(keys[0]).all():
        out[start == 0] = UNKNOWN_AGE
    return out


def transient_rows(visits: Sequence[NDArray[np.float64]]) -> int:
    r"""Return the length of the transient after a mode is entered, from the recorded visits to it.

    .. math:: d^2(x) = (x - \mu)^T S^{-1} (x - \mu)

    with mean and covariance of the second half of every visit. Ages are taken together as 0, 1, 2 to 3, 4 to 7 and so
    on; a transient ends before the first two of these in a row whose mean :math:`d^2` is not above twice that of the
    second halves. It takes half of the longest visit at most.

    Parameters
    ----------
    visits : sequence of ndarray, shape (rows, channels)
        Each from its first row, after a change of mode.
    """
    settled = np.vstack([one[len(one) // 2 :] for one in visits])
    spread = settled.std(axis=0)
    moves = spread > 0
    if not moves.any():
        return 0
    mean = settled.mean(axis=0)
    z = (settled - mean)[:, moves] / spread[moves]
    values, vectors = np.linalg.eigh(z.T @ z / len(z))
    kept = values > DATA_ROUNDING * values[-1]
    whiten = vectors[:, kept] / np.sqrt(values[kept])
    entered = [((one[: len(one) // 2] - mean)[:, moves] / spread[moves]) @ whiten for one in visits]
    distances = [np.mean(one**2, axis=1) for one in entered]
    end, start, alike = 0, 0, 0
    while alike < 2:
        stop = max(1, 2 * start)
        rows = np.concatenate([one[start:stop] for one in distances])
        if not len(rows):
            break
        unlike = rows.mean() > _UNLIKE
        alike = 0 if unlike else alike + 1
        end = min(stop, max(map(len, distances))) if unlike else end
        start = stop
    return end


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
        The value of the method for this mode, for a :class:`residua.Monitor`.
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
        """Refuse: each mode has a generator of its own.

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
        count, without = counted(len(self.modes), "mode"), len(self.without_model)
        return f"{count}{f', {without} without a model,' if without else ''} by {listed(self.signals.names)}"

    def __str__(self) -> str:
        lines = []
        for one in self.modes.values():
            are = "is" if len(one.still) == 1 else "are"
            still = f"; {listed(one.still)} never moved, and {are} not looked at" if one.still else ""
            lines.append(f"{one.name}: {counted(one.samples, 'row')}, {one.transient} after a change left out{still}")
        lines += [f"{name}: no model, {why}" for name, why in self.without_model.items()]
        return "\n".join([repr(self), *lines, *self.notes])


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
    absent = [name for name in signals.names if name not in gathered.channels]
    if absent:
        raise DataError(
            f"by: there is no channel {listed(absent)}; there are {listed(gathered.channels)} "
            "(columns of arrays have the names that inputs= and outputs= say)"
        )
    place = [gathered.channels.index(name) for name in signals.names]
    numbers = sorted({one.recording for one in gathered.segments})
    rows = dict(zip(numbers, (one[:, place] for one in gathered.whole()), strict=True))
    for j, (name, edges) in enumerate(zip(signals.names, signals.edges, strict=True)):
        column = np.concatenate([one[:, j] for one in rows.values()])
        values = np.unique(column[np.isfinite(column)])
        if edges is None and len(values) > MOST_VALUES:
            raise SettingError(
                f"by: {echo(name)} has {len(values)} different values from {values[0]:.4g} to {values[-1]:.4g}, which "
                f"would be as many modes ({MOST_VALUES} at most): name the values that divide it, "
                f"by={{{echo(name)}: [{float(np.median(values)):.3g}]}}, or leave it to the channels"
            )
    keys = {number: signals.keys(one) for number, one in rows.items()}
    visited = _Visited(gathered, signals, keys, {number: ages(one) for number, one in keys.items()})
    modes: dict[str, OperatingMode] = {}
    without: dict[str, str] = {}
    for key in distinct(keys.values()):
        name = signals.label(key)
        mode = _mode(visited, key, name, method, wait, enough)
        if isinstance(mode, str):
            without[name] = mode
        else:
            modes[name] = mode
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

    def parts(self, key: Key, transient: int) -> list[Segment]:
        """Return the runs of complete rows in a mode, without the transient after a change."""
        out = []
        for one in self.gathered.segments:
            here = rows_in(self.keys[one.recording], key) & (self.ages[one.recording] >= transient)
            out += [one.cut(start, stop) for start, stop in runs(here[one.start : one.stop]).tolist()]
        return out


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
    # visits that begin with a change
    whole = [one for one in all_rows.segments if visited.ages[one.recording][one.start] == 0 and len(one) > 1]
    entered = [one.rows(0, len(one))[:, columns] for one in whole] if wait is None else []
    transient = transient_rows(entered) if entered else wait or 0
    settled = gathered.with_segments(visited.parts(key, transient))
    rows = settled.n_samples
    still = tuple(one for one in channel_facts(settled).constant() if one in candidates) if rows > 1 else ()
    moving = [one for one in candidates if one not in still]
    wanted = max(30, KNOWN * len(moving)) if enough is None else enough
    if rows < wanted:
        return f"{counted(rows, 'row')} of the {wanted} that it needs" + (
            f", {all_rows.n_samples - rows} more after changes" if transient else ""
        )
    u_names = tuple(one for one in gathered.inputs if one in moving)
    y_names = tuple(one for one in gathered.outputs if one in moving)
    if not y_names:
        return f"none of {listed([one for one in gathered.outputs if one in candidates])} ever changes in {rows} rows"
    u = [gathered.channels.index(one) for one in u_names]
    y = [gathered.channels.index(one) for one in y_names]
    pairs = [(data[:, u], data[:, y]) for data in settled.data()]
    try:
        design = method(pairs, inputs=u_names or None, outputs=y_names, dt=gathered.dt)
        if isinstance(design, RecordedModel):
            design = kalman_filter(design.plant.with_sensor_faults())
    except (DataError, ModelError, DesignError, AccuracyError) as error:  # of this mode; the others may have a model
        return f"{counted(rows, 'row')}: {error}"
    return OperatingMode(key, name, for_monitor(design), rows, transient, still)
