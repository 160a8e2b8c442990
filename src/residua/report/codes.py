"""A bank on a page: the codes of the faults, what fired, and what was read."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from residua.monitor.naming import column_read
from residua.report.tables import MAX_ROWS, html_table
from residua.report.text import escape, percent, seconds

if TYPE_CHECKING:
    from residua.monitor.alarm import Alarm
    from residua.monitor.diagnosis import Diagnosis

CODE_RULES = (
    "A pattern of fired members is read in this order: exact, the code of one fault; degraded, the code of one fault "
    "with members silent, and of no other (only where no code is part of another); nearest, one code nearer than all "
    "others, within the members that may differ, and the pattern is "
    "part of no other fault's code; else it is more than one fault, or one that the bank does not know. "
    "The score is the fraction of the members that agree with a code."
)


def code_table(diagnosis: Diagnosis) -> str:
    """Return members against faults, with what fired in the main alarm as last row; empty without codes."""
    codes = diagnosis.codes
    if codes is None:
        return ""
    main = diagnosis.main_alarm
    reading = main.reading if main else None
    fired = None if reading is None else np.array(reading.pattern)
    rows = []
    entries = [*zip(codes.labels, codes.codes.T, strict=True)]
    entries += [(fault, np.zeros(len(codes.members), dtype=bool)) for fault in codes.unjudged]
    which = None if reading is None else column_read(reading, codes)
    for g, (label, code) in enumerate(entries):
        name = f'<b>{escape(label)}</b> <span class="tag">read</span>' if g == which else escape(label)
        cells = [_cell(bool(on), fired is not None and bool(on) != bool(fired[m])) for m, on in enumerate(code)]
        agree = "" if fired is None else f'<td class="num">{int(np.sum(code == fired))} of {len(code)}</td>'
        rows.append([f'<th scope="row">{name}</th>', *cells, *([agree] if agree else [])])
    if fired is not None:
        seen = [_cell(bool(on), False) for on in fired]
        rows.append(['<th scope="row"><i>fired, main alarm</i></th>', *seen, '<td class="num">–</td>'])
    header = ["What fails", *(f"<span>{escape(name)}</span>" for name in codes.members)]
    header += ["Agree"] if fired is not None else []
    kind = "matrix codes upright" if len(codes.members) > 8 else "matrix codes"
    differ = "; marked where a code differs from what fired" if fired is not None else ""
    later = "; <i>settled</i>: what a fault still fires once it is constant" if any(codes.settled) else ""
    caption = f"Which members each fault fires (● fires, · stays silent{differ}{later})"
    return f"<h3>Codes</h3>{html_table(header, rows, caption=caption, kind=kind)}"


def _cell(on: bool, differs: bool) -> str:
    kind, title, mark = ("on", "fires", "●") if on else ("off", "stays silent", "·")
    return f'<td class="{kind}{" differs" if differs else ""}" title="{title}">{mark}</td>'


def code_alarm_table(diagnosis: Diagnosis) -> str:
    """Return the alarms of a bank, each with what fired and what was read."""
    rows = []
    main = diagnosis.main_alarm
    for k, alarm in enumerate(diagnosis.alarms[:MAX_ROWS], 1):
        mark = ' <span class="tag">main</span>' if alarm is main and len(diagnosis.alarms) > 1 else ""
        rows.append(
            [
                f"{k}{mark}",
                *(f'<td class="num">{seconds(t)}</td>' for t in (alarm.onset, alarm.raised)),
                f'<td class="num">{"end of recording" if alarm.ended is None else seconds(alarm.ended)}</td>',
                escape(", ".join(alarm.reading.fired) or "none") if alarm.reading else "–",
                f'<td class="name">{escape(alarm.reading.meaning) if alarm.reading else "–"}</td>',
                f'<td class="num">{read_share(alarm)}</td>',
            ]
        )
    header = ["Alarm", "Onset", "Raised", "Ended", "Fired", "Read as", "Of its samples"]
    more = len(diagnosis.alarms) - MAX_ROWS
    note = f'<p class="muted">… and {more:,} more alarms.</p>' if more > 0 else ""
    return html_table(header, rows) + note


def read_share(alarm: Alarm) -> str:
    """Return in how many of an alarm's samples its pattern stood."""
    return "–" if alarm.read_share is None else percent(round(1000 * alarm.read_share), 1000)


def member_order(diagnosis: Diagnosis, most: int) -> list[int]:
    """Return the member numbers in the order in which they are shown.

    As they come when there are no more than ``most``; otherwise those that went furthest over their thresholds first.
    """
    n = len(diagnosis.members)
    if n <= most or not len(diagnosis.time):
        return list(range(n))
    ratio: NDArray[np.float64] = diagnosis.member_statistics / diagnosis.member_thresholds
    largest = np.where(np.isfinite(ratio), ratio, 0.0).max(axis=0)
    return np.argsort(-largest, kind="stable").tolist()
