"""A diagnosis in a notebook: its statistic over time, and its alarms."""

from __future__ import annotations

from typing import TYPE_CHECKING

from residua.decide.statement import SHOWN_ALARMS, left_out_text, longest_alarms
from residua.report.tables import ALARM_TIMES, MAX_ROWS, alarm_times
from residua.shown import line_chart, notes, table

if TYPE_CHECKING:
    from residua.monitor.diagnosis import Diagnosis


def parts_of(diagnosis: Diagnosis) -> list[str]:
    """Return a chart, the longest alarms and the notes of a diagnosis, as HTML."""
    if not len(diagnosis.time):
        return [notes(diagnosis.notes)]
    time, clock, alarms = diagnosis.time, diagnosis.clock, diagnosis.alarms
    last = float(time[-1])
    chart = line_chart(
        time,
        diagnosis.statistic,
        label="Statistic and its threshold, alarms in red",
        limit=diagnosis.threshold,
        spans=[(one.raised, last if one.ended is None else one.ended) for _, one in longest_alarms(alarms, MAX_ROWS)],
        ends=(clock.at(float(time[0])), clock.at(last)),
    )
    rows = [
        (k, *alarm_times(one, clock), " and ".join(" or ".join(group) for group in one.named) or "no fault named")
        + (one.word.kind if one.word else "",)
        for k, one in longest_alarms(alarms, SHOWN_ALARMS)
    ]
    more = [left_out_text(alarms, SHOWN_ALARMS)] if rows else []
    return [
        chart,
        table(["alarm", *map(str.lower, ALARM_TIMES), "most likely", "how sure"], rows),
        notes([*filter(None, more), *diagnosis.notes]),
    ]


__all__ = ["parts_of"]
