"""Learning faults from labelled recordings: choice of samples, directions and codes, and the table of learnt faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import is_number
from residua.decide.isolation import Isolation, IsolationSettings
from residua.decide.learnt_faults import (
    LearntCodes,
    LearntDirections,
    LearntFault,
    learnt_code,
    learnt_direction,
    learnt_label,
    with_learnt,
)
from residua.decide.structured import CodeTest, longest_code
from residua.decide.test import ResidualTest
from residua.decide.whitened_norm import is_selection
from residua.decide.whitening import whitening_matrix
from residua.errors import DataError, NotFittedError, SettingError
from residua.monitor.fused import run_block
from residua.monitor.running import Decisions, initial_state
from residua.monitor.specification import Specification
from residua.visible import echo
from residua.words import counted, number

#: Samples that a learnt direction is judged over where nothing else names faults.
WINDOW = 50


@dataclass(frozen=True, eq=False)
class LabelledRun:
    """A recording of a fault: times, and plant inputs and outputs of shape (1, time, channels)."""

    time: NDArray[np.float64]
    data: NDArray[np.float64]


@dataclass(frozen=True)
class LearntRow:
    """One learnt fault, as shown in the table of a monitor.

    Attributes
    ----------
    name : str
        As diagnoses say it.
    recordings, samples : int
    independent : float
        Samples that the residuals are worth.
    cone : float
        Half-angle in degrees; ``None`` for a fault that is known by its code.
    fires : tuple of str
        Members of a bank that it fires; empty for a direction.
    modelled : float or None
        Angle in degrees to the fault of the model that has the same name; ``None`` without one.
    nearest : str
        The other group of faults whose direction is nearest, or that has the same code; empty without.
    apart : float or None
        Angle in degrees to that.
    """

    name: str
    recordings: int
    samples: int
    independent: float
    cone: float | None
    fires: tuple[str, ...]
    modelled: float | None
    nearest: str
    apart: float | None


class LearntFaults(tuple[LearntRow, ...]):
    """The learnt faults of a monitor, as a table: print it, or read its rows."""

    __slots__ = ()

    def cells(self) -> tuple[list[str], list[list[str]]]:
        """Return header and rows as text."""
        header = ["fault", "recordings", "samples", "independent", "cone or code", "as modelled", "nearest other"]
        rows = [
            [
                row.name,
                str(row.recordings),
                str(row.samples),
                number(row.independent, 3),
                ", ".join(row.fires) if row.cone is None else f"{row.cone:.2g}°",
                "–" if row.modelled is None else f"{row.modelled:.2g}° off",
                (row.nearest or "–") + ("" if row.apart is None else f", {row.apart:.2g}°"),
            ]
            for row in self
        ]
        return header, rows

    def __str__(self) -> str:
        if not self:
            return "no learnt faults"
        header, rows = self.cells()
        width = [max(len(line[c]) for line in (header, *rows)) for c in range(len(header))]
        lines = ("  ".join(cell.ljust(w) for cell, w in zip(line, width, strict=True)) for line in (header, *rows))
        return "\n".join(line.rstrip() for line in lines)


def learnt_table(isolation: Isolation) -> LearntFaults:
    """Return the table of the faults learnt by an isolation."""
    if isinstance(isolation, LearntDirections):
        return LearntFaults(_row_of_direction(isolation, j) for j in range(len(isolation.faults)))
    if isinstance(isolation, LearntCodes):
        return LearntFaults(_row_of_code(isolation, fault) for fault in isolation.faults)
    return LearntFaults()


def _row_of_direction(isolation: LearntDirections, j: int) -> LearntRow:
    fault, angles = isolation.faults[j], isolation.angles(j)
    own = [angle for name, angle in angles if fault.name in name.split(" or ")]
    nearest, apart = angles[0] if angles else ("", None)
    modelled = own[0] if own and isolation.labels[j] != fault.name else None
    return LearntRow(
        isolation.labels[j],
        fault.recordings,
        fault.samples,
        fault.independent,
        fault.cone,
        (),
        modelled,
        nearest,
        apart,
    )


def _row_of_code(isolation: LearntCodes, fault: LearntFault) -> LearntRow:
    named = {name for group in isolation.groups for name in group}
    marked = learnt_label(fault.name, {fault.name})
    label = marked if marked in named else fault.name
    group = next(g for g in isolation.groups if label in g)
    fires = tuple(m for m, on in zip(isolation.members, fault.code, strict=True) if on)
    others = " or ".join(name for name in group if name != label)
    return LearntRow(label, fault.recordings, fault.samples, fault.independent, None, fires, None, others, None)


def checked_name(name: Any) -> str:
    """Return the name of a fault, or raise."""
    if not isinstance(name, str) or not name.strip():
        raise SettingError(f"name must be a text that names the fault in the recording, got {echo(name)}")
    return name


def judging_window(isolate: IsolationSettings, isolation: Isolation) -> int:
    """Return the number of samples from which a learnt direction is judged, or raise if there is none."""
    if isolate.kind == "matched":
        raise SettingError(
            "matched filters name a fault by its response from its arrival on, and a recording shows a direction: "
            "Monitor(design.generator, isolate=Directional()) learns faults"
        )
    return max(isolation.samples, 1) if isolation.groups or isolation.unjudged else WINDOW


def whitens(test: ResidualTest) -> bool:
    """Tell whether a test has a whitening of all residuals."""
    return not is_selection(test.metric) and test.metric.shape[0] == test.metric.shape[1]


def whitening_of(test: ResidualTest, normal: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """Return the whitening of residuals in which directions are learnt: that of the test, or of the fitted data."""
    if whitens(test):
        return test.metric
    if normal is None:
        raise NotFittedError(
            "the test of this monitor does not whiten, and no covariance of fault-free residuals is known: fit() the "
            "monitor to fault-free data before it learns faults"
        )
    return whitening_matrix(normal)


def learnt_from_blocks(
    name: str,
    clocks: Sequence[NDArray[np.float64] | None],
    blocks: Sequence[NDArray[np.float64]],
    interval: Any,
    step: float,
    spec: Specification,
    isolate: IsolationSettings,
    normal: NDArray[np.float64] | None,
) -> LearntFault:
    """Return the fault shown by blocks of (1, time, channels); those without a clock have times by their step."""
    runs = [
        LabelledRun(step * np.arange(data.shape[1]) if clock is None else clock, data)
        for clock, data in zip(clocks, blocks, strict=True)
    ]
    window = judging_window(isolate, spec.isolation)
    space = None if spec.isolation.coding is not None else whitening_of(spec.test, normal)
    return learnt_from(name, runs, intervals_of(interval, len(runs)), spec, space, window)


def learnt_from(
    name: str,
    runs: Sequence[LabelledRun],
    intervals: Sequence[Any],
    spec: Specification,
    space: NDArray[np.float64] | None,
    window: int,
) -> LearntFault:
    """Return the fault shown by recordings: a code by ``spec.isolation``, or a direction in ``space``."""
    isolation, rows, patterns, samples, spans = spec.isolation, [], [], 0, []
    for k, (run, interval) in enumerate(zip(runs, intervals, strict=True), 1):
        which = f"recording {k} of {len(runs)} of {name!r}" if len(runs) > 1 else f"the recording of {name!r}"
        if len(run.data) != 1:
            raise DataError(f"{which} has the shape (plants, time, channels): give (time, channels), or several")
        decisions = run_block(spec, initial_state(spec, 1), run.data)[1].of(0)
        chosen = _chosen(interval, run.time, decisions, which) & decisions.usable
        if not chosen.any():
            raise DataError(
                f"{which} has no usable sample in the interval of the fault: of all {len(run.time)}, "
                f"{int(decisions.missing.sum())} lack a value ({int(decisions.aside.any(axis=1).sum())} have one that "
                f"cannot be, by plausible=), and the filter settles for {spec.settle} after each start"
            )
        samples += int(chosen.sum())
        if isinstance(interval, tuple):
            spans.append(f"{_span(interval)} took {int(chosen.sum())} of {counted(len(chosen), 'sample')}")
        if isinstance(isolation, CodeTest):
            patterns.append(longest_code(decisions.code, chosen))
        else:
            rows.append(decisions.residuals[chosen] - spec.test.center)
    try:
        if isinstance(isolation, CodeTest):
            return learnt_code(name, patterns, samples, isolation.members)
        assert space is not None
        return learnt_direction(name, rows, space, window)
    except DataError as error:
        if not spans:
            raise
        raise DataError(f"{error}. In the times of the recording, seconds: {'; '.join(spans)}") from error


def _span(interval: tuple[float, float]) -> str:
    """Describe an interval."""
    start, stop = interval
    until = "to the end" if np.isposinf(stop) else f"to {stop:g}"
    return f"interval=({start:g}, {stop:g}), from {start:g} s {until}{'' if np.isposinf(stop) else ' s'},"


def _chosen(interval: Any, time: NDArray[np.float64], decisions: Decisions, which: str) -> NDArray[np.bool_]:
    """Return the samples of the fault: a mask, those of an interval of time, or those from the first alarm on."""
    if interval is None:
        on = np.flatnonzero(decisions.alarm)
        if not on.size:
            raise DataError(f"{which} raises no alarm: give the time of the fault, interval=(start, stop), in seconds")
        return np.arange(len(time)) >= on[0]
    mask = np.asarray(interval)
    if mask.dtype == bool:
        if mask.shape != time.shape:
            raise DataError(f"the mask of {which} has shape {mask.shape}, the recording has {len(time)} samples")
        return mask
    start, stop = (float(x) for x in mask)
    if not start < stop:
        raise SettingError(f"interval of {which} must be (start, stop) with start before stop, got {echo(interval)}")
    chosen = (time >= start) & (time < stop)
    if not chosen.any():
        raise DataError(
            f"{which} has no sample from {start:g} to {stop:g} s: its times are {time[0]:g} to {time[-1]:g} s"
        )
    return chosen


def intervals_of(interval: Any, count: int) -> list[Any]:
    """Return an interval for each recording: one for all, or a list of as many."""
    if interval is None or (isinstance(interval, np.ndarray) and interval.dtype == bool):
        return [interval] * count
    if isinstance(interval, (tuple, list, np.ndarray)) and len(interval) == 2:
        start, stop = interval
        if is_number(start) and (is_number(stop) or (isinstance(stop, float) and stop == np.inf)):
            return [(float(start), float(stop))] * count
    if isinstance(interval, list) and len(interval) == count:
        return [one for part in interval for one in intervals_of(part, 1)]
    if isinstance(interval, np.ndarray) and interval.size > 2 and np.isin(interval, (0, 1)).all():
        raise SettingError(
            f"interval is an array of {interval.dtype}: a mask of samples is one of booleans, interval.astype(bool); "
            "numbers are times in seconds, (start, stop)"
        )
    raise SettingError(
        "interval must be (start, stop) in seconds, an array of booleans, or a list with one of these for each of "
        f"{counted(count, 'recording')}, got {echo(interval)}"
    )


__all__ = ["LearntFaults", "LearntRow"]


def with_faults(
    plain: Specification,
    faults: tuple[LearntFault, ...],
    normal: NDArray[np.float64] | None,
    isolate: IsolationSettings,
) -> Specification:
    """Return the specification extended by learnt faults."""
    if not faults:
        return plain
    window = judging_window(isolate, plain.isolation)
    isolation = with_learnt(plain.isolation, faults, plain.test, lambda: whitening_of(plain.test, normal), window)
    return replace(plain, isolation=isolation)
