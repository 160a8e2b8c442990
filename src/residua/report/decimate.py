"""Fewer points for a chart, or for a diagnosis of a recording larger than memory, without losing an extreme."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from residua.monitor.diagnosis import Diagnosis

#: Samples that are gathered at once: bounds memory.
_AT_ONCE = 1 << 18
#: Points that are kept of each series at most.
POINTS = 20_000
#: The series of a diagnosis but its times.
_SERIES = ("residuals", "statistic", "alarm", "decided", "missing", "scores", "parts", "match", "signals")


@dataclass(frozen=True, eq=False)
class Bins:
    """Bins of samples for the points of a chart.

    Attributes
    ----------
    n_samples : int
    width : int
        Samples per bin; 1 when every sample is drawn. Each wider bin becomes two points.
    """

    n_samples: int
    width: int

    @property
    def n_points(self) -> int:
        """Points per series."""
        return self.n_samples if self.width == 1 else 2 * -(-self.n_samples // self.width)

    def times(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the times of the points: the start and the middle of each bin."""
        if self.width == 1:
            return time
        at = np.arange(self.n_points) * (self.width // 2)
        beyond = np.maximum(at - (self.n_samples - 1), 0)
        step = (time[-1] - time[0]) / max(self.n_samples - 1, 1)
        return time[np.minimum(at, self.n_samples - 1)] + beyond * step

    def extremes(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the smallest and largest finite value of each bin, in their order in time.

        NaN where a bin has no finite value.
        """
        if self.width == 1:
            return np.where(np.isfinite(values), values, np.nan)
        at_once = max(1, _AT_ONCE // self.width) * self.width
        parts = [self._of_piece(values[k : k + at_once]) for k in range(0, self.n_samples, at_once)]
        return np.concatenate(parts)

    def _of_piece(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the extremes of the bins of a piece, which consists of whole bins except at its end."""
        n_bins = -(-len(values) // self.width)
        blocks = np.full(n_bins * self.width, np.nan)
        blocks[: len(values)] = np.where(np.isfinite(values), values, np.nan)
        blocks = blocks.reshape(n_bins, self.width)
        rows = np.arange(n_bins)
        low = np.where(np.isnan(blocks), np.inf, blocks).argmin(axis=1)
        high = np.where(np.isnan(blocks), -np.inf, blocks).argmax(axis=1)
        first, second = np.minimum(low, high), np.maximum(low, high)
        return np.column_stack([blocks[rows, first], blocks[rows, second]]).ravel()


def choose_bins(n_samples: int, max_points: int) -> Bins:
    """Return bins that give at most ``max_points`` points per series.

    Parameters
    ----------
    n_samples : int
    max_points : int
        At least 2.

    Returns
    -------
    Bins
        One bin per sample when the samples fit; otherwise bins of an even number of samples.

    Examples
    --------
    >>> from residua.report.decimate import choose_bins
    >>> import numpy as np
    >>> bins = choose_bins(9, 6)
    >>> bins.width, bins.n_points
    (4, 6)
    >>> bins.extremes(np.array([0.0, 5, 1, -2, 3, 3, 3, 4, 7])).tolist()
    [5.0, -2.0, 3.0, 4.0, 7.0, 7.0]
    """
    if n_samples <= max_points:
        return Bins(n_samples, 1)
    width = -(-n_samples // max(1, max_points // 2))
    return Bins(n_samples, width + width % 2)


def spans(time: NDArray[np.float64], intervals: NDArray[np.int64], limit: int = 2000) -> list[list[float]]:
    """Return sample intervals as times, joining those too close for a chart.

    Parameters
    ----------
    time : ndarray, shape (T,)
    intervals : ndarray, shape (k, 2)
        First sample and one past the last, in order.
    limit : int
        With more intervals than this, gaps below 1/4000 of the recording are closed.
    """
    if len(intervals) == 0 or len(time) == 0:
        return []
    last = len(time) - 1
    start = time[np.minimum(intervals[:, 0], last)]
    stop = time[np.clip(intervals[:, 1], 0, last)]
    if len(start) > limit:
        wide = start[1:] - stop[:-1] > (time[-1] - time[0]) / 4000
        start = start[np.concatenate([[True], wide])]
        stop = stop[np.concatenate([wide, [True]])]
    return [[float(f"{a:.9g}"), float(f"{b:.9g}")] for a, b in zip(start, stop, strict=True)]


def thinned(diagnosis: Diagnosis, table: str) -> Diagnosis:
    """Return a diagnosis with at most so many points of each series, all of it in memory.

    Numbers are the smallest and the largest of each bin, flags those that are set anywhere in it. Alarms, with their
    sample numbers, counts and texts are those of the whole recording.

    Parameters
    ----------
    diagnosis : Diagnosis
    table : str
        Where the full table is; empty if it was not written.
    """
    bins = choose_bins(len(diagnosis.time), POINTS)
    series = {name: _of(bins, getattr(diagnosis, name)) for name in _SERIES}
    if bins.width == 1:
        return replace(diagnosis, time=np.array(diagnosis.time), **series)
    recording = replace(
        diagnosis.recording,
        compared=(),  # an output and its prediction are thinned at different samples
        thinned=True,
        counted=diagnosis.totals,
        table=table,
    )
    return replace(diagnosis, **series, time=bins.times(diagnosis.time), recording=recording)


def _of(bins: Bins, values: Any) -> Any:
    if is_dataclass(values):
        return type(values)(**{one.name: _of(bins, getattr(values, one.name)) for one in fields(values)})  # pyright: ignore
    if not isinstance(values, np.ndarray) or len(values) != bins.n_samples:
        return values
    if bins.width == 1:
        return np.array(values)
    if values.dtype.kind == "f":
        out = np.zeros((bins.n_points, *values.shape[1:]))
        for k in np.ndindex(values.shape[1:]):
            out[:, *k] = bins.extremes(values[:, *k])
        return out
    starts = np.arange(0, bins.n_samples, bins.width)
    one = np.logical_or.reduceat(values, starts, axis=0) if values.dtype.kind == "b" else values[starts]
    return np.repeat(one, 2, axis=0)
