"""Data of the charts of a page, as plain values for its script."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from residua.arrays import runs
from residua.decide.sizes import fault_unit
from residua.report.choosing import SHOWN_FAULTS, shown_groups
from residua.report.codes import member_order
from residua.report.contributions import averaged_residuals
from residua.report.decimate import Bins, choose_bins, spans
from residua.report.signals import signal_charts
from residua.report.text import rounded, visible, with_unit

if TYPE_CHECKING:
    from residua.monitor.diagnosis import Diagnosis

#: Most points that one series is drawn with, and all series of one diagnosis together.
MAX_POINTS = 20_000
MAX_POINTS_TOTAL = 400_000
#: Residuals that are shown at once; the others are behind a click.
SHOWN_RESIDUALS = 6
#: Members of a bank whose statistics are shown at once.
SHOWN_MEMBERS = 8
#: A logarithmic axis of a norm begins at this fraction of its threshold: a norm of one residual passes through zero.
PEAK_FLOOR = 0.02
#: Units of a time axis without dates: name, seconds, and the length of a recording from which on it is used.
_UNITS = (("d", 86400.0, 4 * 86400.0), ("h", 3600.0, 2 * 3600.0))
#: The statistic starts on a logarithmic axis when it goes this far over its threshold.
LOG_FROM = 20.0


def residual_unit(diagnosis: Diagnosis, name: str) -> str:
    """Return the unit of a residual: that of its output, if it is an output's estimation error.

    That of an estimate is that of the fault.
    """
    plant = diagnosis.generator.plant
    fault = estimated_fault(diagnosis, name)
    if fault:
        return fault_unit(plant, fault)
    output = name.removeprefix("r ")
    return str(plant.units.get(output, "")) if output != name and output in plant.outputs else ""


def estimated_fault(diagnosis: Diagnosis, name: str) -> str:
    """Return the fault estimated by a residual; empty for any other residual."""
    named = dict(zip(diagnosis.generator.residuals, diagnosis.generator.estimated, strict=False))
    return named.get(name, "")


def points_per_series(diagnosis: Diagnosis) -> int:
    """Return the largest number of points in a series of this diagnosis."""
    n_series = len(diagnosis.generator.residuals) * (1 + (diagnosis.test.averaged > 1)) + 1 + len(diagnosis.members)
    n_series += (
        min(len(diagnosis.groups), SHOWN_FAULTS) + diagnosis.signals.shape[1] + len(diagnosis.recording.compared)
    )
    return int(np.clip(MAX_POINTS_TOTAL // n_series, 1000, MAX_POINTS))


def chart_data(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the data of all charts of one diagnosis, as plain values.

    Parameters
    ----------
    diagnosis : Diagnosis

    Returns
    -------
    dict
        ``x`` (times in seconds), ``clock`` (what they are called), ``spans`` (alarm, missing, undecided, began),
        ``onsets``, ``charts`` and ``binned`` (samples per bin).
    """
    bins = choose_bins(len(diagnosis.time), points_per_series(diagnosis))
    undecided = ~diagnosis.decided & ~diagnosis.missing
    alarms = np.array([[a.start, a.stop] for a in diagnosis.alarms], dtype=np.int64).reshape(-1, 2)
    data = over_time(diagnosis.time, bins, alarms, diagnosis.missing, undecided)
    data["spans"]["began"] = began_spans(diagnosis)
    return data | {
        "clock": _clock_of(diagnosis),
        "onsets": onsets(diagnosis),
        "charts": [
            *_residual_charts(diagnosis, bins),
            _statistic_chart(diagnosis.statistic, diagnosis.threshold, bins) | _peak_axis(diagnosis),
            *_member_charts(diagnosis, bins),
            *_score_charts(diagnosis, bins),
            *signal_charts(diagnosis, bins),
        ],
    }


def over_time(
    time: NDArray[np.float64],
    bins: Bins,
    alarms: NDArray[np.int64],
    missing: NDArray[np.bool_],
    undecided: NDArray[np.bool_],
) -> dict[str, Any]:
    """Return the data that all charts over a time axis share, without charts."""
    return {
        "x": time_axis(bins.times(time)),
        "clock": plain_clock(time),
        "ends": [float(time[0]), float(time[-1])] if len(time) else [0.0, 1.0],
        "binned": bins.width,
        "spans": {
            "alarm": spans(time, alarms),
            "missing": spans(time, runs(missing)),
            "undecided": spans(time, runs(undecided)),
            "began": [],
        },
        "onsets": [],
        "charts": [],
    }


def by_interest(diagnosis: Diagnosis) -> list[int]:
    """Return the residual numbers in the order of display.

    As they come when all are shown at once; otherwise those that went furthest out of their band first.
    """
    n = len(diagnosis.generator.residuals)
    if n <= SHOWN_RESIDUALS or not len(diagnosis.time):
        return list(range(n))
    away = np.abs(diagnosis.residuals - diagnosis.test.center)
    largest = np.where(np.isfinite(away), away, 0.0).max(axis=0)
    band = np.where(np.isfinite(diagnosis.test.band) & (diagnosis.test.band > 0), diagnosis.test.band, np.inf)
    return np.argsort(-largest / band, kind="stable").tolist()


def judged_range(diagnosis: Diagnosis, i: int) -> list[float] | None:
    """Return the range of a residual over the judged samples; ``None`` without any.

    A filter that starts from a wrong state settles in a transient that may dwarf every fault.
    """
    seen = diagnosis.residuals[diagnosis.decided, i]
    seen = seen[np.isfinite(seen)]
    return [float(seen.min()), float(seen.max())] if seen.size else None


def _residual_charts(diagnosis: Diagnosis, bins: Bins) -> list[dict[str, Any]]:
    charts = []
    means = averaged_residuals(diagnosis) if diagnosis.test.averaged > 1 and not diagnosis.members else None
    for i in by_interest(diagnosis):
        center, band = float(diagnosis.test.center[i]), float(diagnosis.test.band[i])
        known = np.isfinite(center) and np.isfinite(band)
        name = diagnosis.generator.residuals[i]
        charts.append(
            {
                "kind": "residual",
                "label": visible(name),
                "unit": visible(residual_unit(diagnosis, name)),
                "band": [center - band, center + band] if known else None,
                "limits": judged_range(diagnosis, i),
                "y": [rounded(bins.extremes(diagnosis.residuals[:, i]))],
                "names": [visible(name)],
            }
        )
        if means is not None:
            charts[-1]["y"].append(rounded(bins.extremes(means[:, i])))
            charts[-1]["names"].append(f"average of {diagnosis.test.averaged}")
        fault = estimated_fault(diagnosis, name)
        if fault:
            charts[-1]["estimate"] = visible(fault)
    return charts


def _statistic_chart(
    statistic: NDArray[np.float64], limit: float, bins: Bins, *, kind: str = "statistic", name: str = "statistic"
) -> dict[str, Any]:
    values = bins.extremes(statistic)
    threshold = float(limit)
    usable = np.isfinite(threshold) and threshold > 0
    seen = values[np.isfinite(values)]
    return {
        "kind": kind,
        "label": visible(name),
        "unit": "",
        "threshold": threshold if np.isfinite(threshold) else None,
        "log": bool(usable and seen.size and seen.max() > LOG_FROM * threshold),
        "y": [rounded(values, relative=True)],
        "names": [visible(name)],
    }


def _member_charts(diagnosis: Diagnosis, bins: Bins) -> list[dict[str, Any]]:
    charts = [
        _statistic_chart(
            diagnosis.parts.statistics[:, m],
            diagnosis.parts.thresholds[m],
            bins,
            kind="member",
            name=diagnosis.members[m],
        )
        | _peak_axis(diagnosis, m)
        | _own_alarms(diagnosis, m)
        for m in member_order(diagnosis, SHOWN_MEMBERS)
    ]
    if diagnosis.test.horizon:  # side by side, norms are compared: one kind of axis for all
        charts = [chart | {"log": any(c["log"] for c in charts)} for chart in charts]
    return charts


def own_alarms(diagnosis: Diagnosis, m: int) -> NDArray[np.int64] | None:
    """Return the alarms of a member of a dedicated bank, as pairs (start, stop); ``None`` for any other bank.

    There it has a fault of its own, and the alarms of the others are none of it.
    """
    dedicated = diagnosis.naming.codes is not None and diagnosis.naming.codes.dedicated
    return runs(diagnosis.parts.fired[:, m]) if dedicated else None


def _own_alarms(diagnosis: Diagnosis, m: int) -> dict[str, Any]:
    pairs = own_alarms(diagnosis, m)
    if pairs is None:
        return {}
    first = [p.since for a in diagnosis.alarms[:50] for p in a.present if p.member == diagnosis.members[m]]
    return {"alarms": spans(diagnosis.time, pairs), "onsets": first}


def onsets(diagnosis: Diagnosis) -> list[float]:
    """Return the first threshold crossings of the alarms and, with several faults present, those of each."""
    alarms = diagnosis.alarms[:50]
    times = [a.onset for a in alarms] + [p.since for a in alarms for p in a.present[1:]]
    return sorted(float(t) for t in dict.fromkeys(times) if np.isfinite(t))


def began_spans(diagnosis: Diagnosis) -> list[list[float]]:
    """Return the intervals in which the alarms began, if both ends are known."""
    spans = [a.began for a in diagnosis.alarms[:50] if a.began is not None]
    return [[b.earliest, b.latest] for b in spans if b.earliest is not None]


def _clock_of(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the time axis of the charts: the clock of the recording, or a unit that fits its length.

    ``base``: the moment that they count from as seconds of a clock without time zones.
    """
    moment = diagnosis.clock.moment
    if moment is not None:
        return {"base": (moment - datetime(1970, 1, 1)).total_seconds(), "unit": "", "factor": 1.0}
    return plain_clock(diagnosis.time)


def plain_clock(time: NDArray[np.float64]) -> dict[str, Any]:
    """Return the time axis of a chart without dates: a unit that fits its length."""
    span = float(np.ptp(time)) if len(time) else 0.0
    unit, factor = next(((u, f) for u, f, least in _UNITS if span >= least), ("s", 1.0))
    return {"base": None, "unit": unit, "factor": factor}


def norm_unit(diagnosis: Diagnosis, member: int | None = None) -> str:
    """Return the unit of the norm of a member's residuals, or of all: theirs if they share one, else none."""
    names = diagnosis.generator.residuals
    if member is not None:
        rows = diagnosis.parts.residuals.get(diagnosis.members[member]) or diagnosis.generator.members[member].residuals
        names = [names[i] for i in rows]
    units = {residual_unit(diagnosis, name) for name in names}
    return units.pop() if len(units) == 1 else ""


def _peak_axis(diagnosis: Diagnosis, member: int | None = None) -> dict[str, Any]:
    """Return unit, axis and floor of a chart of a norm that is neither centred nor whitened; else nothing."""
    if not diagnosis.test.horizon:
        return {}
    limit = diagnosis.threshold if member is None else diagnosis.parts.thresholds[member]
    floor = {"floor": float(limit) * PEAK_FLOOR}
    if member is None and diagnosis.members:
        return {"axis": "ratio [–]"} | floor
    unit = norm_unit(diagnosis, member)
    return {"unit": unit, "axis": with_unit("norm", unit)} | floor


def shows_scores(diagnosis: Diagnosis) -> bool:
    """Tell whether the candidates' scores are informative: not with several faults, each with its member."""
    several = any(alarm.reading is not None and alarm.reading.together for alarm in diagnosis.alarms)
    return bool(diagnosis.groups) and diagnosis.scores.size > 0 and not several


def _score_charts(diagnosis: Diagnosis, bins: Bins) -> list[dict[str, Any]]:
    if not shows_scores(diagnosis):
        return []
    shown = shown_groups(diagnosis)
    columns: list[NDArray[np.float64]] = [bins.extremes(diagnosis.scores[:, g]) for g in shown]
    return [
        {
            "kind": "scores",
            "label": "probability" if any(c.probability is not None for c in diagnosis.candidates) else "score",
            "unit": "",
            "y": [[None if v is None else round(v, 4) for v in rounded(c)] for c in columns],
            "names": [visible(diagnosis.group_names[g]) for g in shown],
            "hidden": len(diagnosis.groups) - len(shown),
        }
    ]


def time_axis(time: NDArray[np.float64]) -> dict[str, Any]:
    """Return times as start, step and count if they are even, as a list otherwise."""
    n = len(time)
    if n > 2:
        step = float(time[-1] - time[0]) / (n - 1)
        even = time[0] + step * np.arange(n)
        if step > 0 and np.abs(time - even).max() <= 1e-3 * step:
            return {"start": float(time[0]), "step": step, "n": n}
    return {"list": [float(f"{t:.10g}") for t in time.tolist()]}
