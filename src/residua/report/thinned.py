"""A diagnosis for drawing, of a recording larger than memory: the extremes of each bin of samples."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from residua.report.decimate import Bins, choose_bins

if TYPE_CHECKING:
    from residua.monitor.diagnosis import Diagnosis

#: Points that are kept of each series at most.
POINTS = 20_000
#: The series of a diagnosis but its times.
_SERIES = (*("residuals", "statistic", "alarm", "decided", "missing", "scores", "parts", "match", "signals"),)


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
        columns = values.reshape(len(values), -1)
        out = [bins.extremes(columns[:, i]) for i in range(columns.shape[1])]
        return np.stack(out, axis=1).reshape(bins.n_points, *values.shape[1:]) if out else _none(bins, values)
    starts = np.arange(0, bins.n_samples, bins.width)
    one = np.logical_or.reduceat(values, starts, axis=0) if values.dtype.kind == "b" else values[starts]
    return np.repeat(one, 2, axis=0)


def _none(bins: Bins, values: NDArray) -> NDArray:
    return np.zeros((bins.n_points, *values.shape[1:]), dtype=values.dtype)
