"""A bank on a page: the codes of the faults, the fired members, and the reading."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from residua.decide.statement import longest_alarms
from residua.decide.structured import column_read
from residua.report.choosing import SHOWN_FAULTS, shown_groups
from residua.report.tables import ALARM_TIMES, MAX_ROWS, alarm_times, html_table, left_out_note, time_cell
from residua.report.text import escape
from residua.words import percent

if TYPE_CHECKING:
    from residua.decide.alarm import Alarm
    from residua.decide.structured import CodeReading, CodeTest
    from residua.monitor.diagnosis import Diagnosis
    from residua.recording.clock import Clock

#: Members of a bank whose part in the codes is shown at once.
MOST_MEMBERS = 16


def code_table(diagnosis: Diagnosis) -> str:
    """Return members against faults, with those fired in the main alarm as last row; empty without codes."""
    codes = diagnosis.naming.codes
    if codes is None:
        return ""
    main = diagnosis.main_alarm
    reading = main.reading if main else None
    fired = None if reading is None else np.array(reading.pattern)
    rows = []
    columns = _shown_members(diagnosis, fired)
    entries = [*zip(codes.labels, codes.codes.T, strict=True)]
    entries += [(fault, np.zeros(len(codes.members), dtype=bool)) for fault in codes.unjudged]
    which = _columns_read(reading, codes)
    total, numbers = len(entries), _shown_codes(diagnosis, which, len(entries))
    compared = None if reading is None or reading.together else fired  # several codes make the pattern together
    for g, (label, code) in ((g, entries[g]) for g in numbers):
        name = f'<b>{escape(label)}</b> <span class="tag">read</span>' if g in which else escape(label)
        cells = [_cell(bool(code[m]), compared is not None and bool(code[m]) != bool(compared[m])) for m in columns]
        agree = "" if compared is None else f'<td class="num">{int(np.sum(code == compared))} of {len(code)}</td>'
        rows.append([f'<th scope="row">{name}</th>', *cells, *([agree] if agree else [])])
    if fired is not None:
        seen = [_cell(bool(fired[m]), False) for m in columns]
        dash = [] if compared is None else ['<td class="num">–</td>']
        rows.append(['<th scope="row"><i>fired, main alarm</i></th>', *seen, *dash])
    header = ["Fault", *(f"<span>{escape(codes.members[m])}</span>" for m in columns)]
    header += ["Agree"] if compared is not None else []
    kind = "matrix codes upright" if len(columns) > 8 else "matrix codes"
    differ = "; marked where a code differs from the main alarm" if compared is not None else ""
    later = "; <i>settled</i>: the members that a fault still fires once it is constant" if any(codes.settled) else ""
    caption = f"Which members each fault fires (● fires, · stays silent{differ}{later})"
    few = [f"{len(numbers)} of {total} codes"] * (len(numbers) < total)
    few += [f"{len(columns)} of {len(codes.members)} members"] * (len(columns) < len(codes.members))
    note = f'<p class="muted">Shown: {" and ".join(few)}, the ones that matter for the main alarm.</p>' if few else ""
    if not numbers or not columns:
        sentence = f"{total} codes of {len(codes.members)} members; nothing fired, so none is shown."
        return f'<h3>Codes</h3><p class="muted">{sentence}</p>'
    return f"<h3>Codes</h3>{html_table(header, rows, caption=caption, kind=kind)}{note}"


def _shown_codes(diagnosis: Diagnosis, read: set[int], total: int) -> list[int]:
    """Return the numbers of the codes to show: all of few; of many those read and those that agree best."""
    if total <= SHOWN_FAULTS:
        return list(range(total))
    if not diagnosis.alarms:
        return []
    return list(dict.fromkeys([*sorted(read), *shown_groups(diagnosis)]))[:SHOWN_FAULTS]


def _shown_members(diagnosis: Diagnosis, fired: NDArray[np.bool_] | None) -> list[int]:
    """Return the numbers of the members to show: all of few; of many those that fired, and those near it."""
    n = len(diagnosis.members)
    if n <= MOST_MEMBERS:
        return list(range(n))
    if fired is None:
        return []
    on = np.flatnonzero(fired).tolist()
    return sorted(dict.fromkeys([*on, *member_order(diagnosis, 0)]), key=lambda m: m not in on)[:MOST_MEMBERS]


def _columns_read(reading: CodeReading | None, codes: CodeTest) -> set[int]:
    """Return the numbers of the codes that were read."""
    if reading is None:
        return set()
    one = column_read(reading, codes)
    return {codes.groups.index(group) for group in reading.together} | ({one} if one is not None else set())


def present_table(diagnosis: Diagnosis) -> str:
    """Return the faults of the main alarm if there are several, with the times of their members; else empty."""
    if len(diagnosis.present) < 2:
        return ""
    clock = diagnosis.clock
    rows = [
        [
            f'<td class="name">{escape(fault.name)}</td>',
            escape(fault.member),
            f'<td class="num">{clock.at(fault.since)}</td>',
            f'<td class="num">{"end of recording" if fault.until is None else clock.at(fault.until)}</td>',
        ]
        for fault in diagnosis.present
    ]
    title = "Faults of the main alarm" if len(diagnosis.alarms) > 1 else "Faults"
    return html_table(["Fault", "Its member", "First fired", "Until"], rows, caption=title, kind="cards")


def _cell(on: bool, differs: bool) -> str:
    kind, title, mark = ("on", "fires", "●") if on else ("off", "stays silent", "·")
    return f'<td class="{kind}{" differs" if differs else ""}" title="{title}">{mark}</td>'


def code_alarm_table(diagnosis: Diagnosis) -> str:
    """Return the alarms of a bank, each with its fired members and its reading."""
    rows = []
    main = diagnosis.main_alarm
    for k, alarm in longest_alarms(diagnosis.alarms, MAX_ROWS):
        mark = ' <span class="tag">main</span>' if alarm is main and len(diagnosis.alarms) > 1 else ""
        rows.append(
            [
                f"{k}{mark}",
                *map(time_cell, alarm_times(alarm, diagnosis.clock)),
                escape(", ".join(alarm.reading.fired) or "none") if alarm.reading else "–",
                f'<td class="name">{escape(_read_as(alarm, diagnosis.clock))}</td>',
                f'<td class="num">{"–" if alarm.present[1:] else read_share(alarm)}</td>',
                f'<td class="name">{alarm.word.kind if alarm.word else "–"}</td>',
            ]
        )
    header = ["Alarm", *ALARM_TIMES, "Fired", "Read as", "Of its samples", "How sure"]
    return html_table(header, rows, kind="cards") + left_out_note(diagnosis)


def _read_as(alarm: Alarm, clock: Clock) -> str:
    if alarm.reading is None:
        return "–"
    if not alarm.reading.together:
        return alarm.reading.meaning
    return f"several faults: {', '.join(f'{p.name} (fired from {clock.at(p.since)})' for p in alarm.present)}"


def read_share(alarm: Alarm) -> str:
    """Return the share of an alarm's samples in which its pattern stood."""
    return "–" if alarm.read_share is None else percent(round(1000 * alarm.read_share), 1000)


def member_order(diagnosis: Diagnosis, most: int) -> list[int]:
    """Return the member numbers in the order of display.

    As they come when there are no more than ``most``; otherwise those that went furthest over their thresholds first.
    """
    n = len(diagnosis.members)
    if n <= most or not len(diagnosis.time):
        return list(range(n))
    ratio: NDArray[np.float64] = diagnosis.parts.statistics / diagnosis.parts.thresholds
    largest = np.where(np.isfinite(ratio), ratio, 0.0).max(axis=0)
    return np.argsort(-largest, kind="stable").tolist()
