"""Operating modes: the joint value of some signals, since when it lasts, and how long a change of it is felt."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.errors import SettingError
from residua.tolerances import DATA_ROUNDING
from residua.visible import echo

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
        return ", ".join(map(_label, self.names, key, self.edges))


def _label(name: str, value: float, edges: tuple[float, ...] | None) -> str:
    if edges is None:
        return f"{name} = {_text(value)}"
    k = int(value)
    if k == 0:
        return f"{name} < {_text(edges[0])}"
    if k == len(edges):
        return f"{name} >= {_text(edges[-1])}"
    return f"{_text(edges[k - 1])} <= {name} < {_text(edges[k])}"


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
    return ModeSignals(names, tuple(_edges(name, by[name]) for name in names))


def _edges(name: str, edges: Any) -> tuple[float, ...] | None:
    if edges is None:
        return None
    values = np.atleast_1d(np.asarray(edges))
    if values.dtype.kind not in "iuf" or values.ndim != 1 or not len(values) or not np.isfinite(values).all():
        raise SettingError(f"by: the edges of {echo(name)} must be numbers, or None, got {echo(edges)}")
    if not (np.diff(values) > 0).all():
        raise SettingError(f"by: the edges of {echo(name)} must increase, got {echo(edges)}")
    return tuple(float(value) for value in values)


def check_few_values(signals: ModeSignals, keys: Sequence[NDArray[np.float64]]) -> None:
    """Raise where a signal has so many values that it is a quantity, not a mode."""
    for j, name in enumerate(signals.names):
        column = np.concatenate([one[:, j] for one in keys])
        values = np.unique(column[np.isfinite(column)])
        if signals.edges[j] is None and len(values) > MOST_VALUES:
            middle = float(np.median(values))
            raise SettingError(
                f"by: {echo(name)} has {len(values)} different values from {values[0]:.4g} to {values[-1]:.4g}, which "
                f"would be as many modes ({MOST_VALUES} at most): name the values that divide it, "
                f"by={{{echo(name)}: [{middle:.3g}]}}, or leave it to the channels"
            )


def distinct(keys: Iterable[NDArray[np.float64]]) -> list[Key]:
    """Return the modes that occur, sorted."""
    found = {tuple(row) for one in keys for row in np.unique(one[np.isfinite(one).all(axis=1)], axis=0).tolist()}
    return sorted(found)


def rows_in(keys: NDArray[np.float64], key: Key) -> NDArray[np.bool_]:
    """Return which rows are in a mode."""
    return np.asarray((keys == np.array(key)).all(axis=1))


def ages(keys: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return for how many rows each row's mode has lasted before it; missing modes count as one mode.

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
    r"""Return for how many rows a mode shows that it was entered, from the recorded visits to it.

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
