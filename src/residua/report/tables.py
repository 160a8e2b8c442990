"""Tables of a page: alarms, structure, similarity of signatures, evidence."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from residua.decide.alarm import Candidate
from residua.decide.statement import angle, capital, left_out_text, longest_alarms, ranked, sizes_text, tied_name
from residua.design.core.evidence import Evidence, format_pole
from residua.monitor.fault_learning import LearntFaults
from residua.monitor.fit_check import DETECTABLE, HEADER
from residua.report.choosing import SHOWN_FAULTS
from residua.report.text import escape
from residua.words import number, score, some

if TYPE_CHECKING:
    from residua.decide.alarm import Alarm
    from residua.design.core.generator import ResidualGenerator
    from residua.linear.subspaces.rank import RankDecision
    from residua.monitor.diagnosis import Diagnosis
    from residua.recording.clock import Clock

#: Headers of the cells of :func:`alarm_times`.
ALARM_TIMES = ("Began", "Raised", "Ended")
#: Rows of a table of alarms, entries of a list of poles or singular values, that are shown at most.
MAX_ROWS = 200
MAX_ENTRIES = 24


@dataclass(frozen=True)
class Table:
    """A table of text for a section of a page.

    Attributes
    ----------
    header : sequence of str
    rows : sequence of sequence of object
        Numbers are shown with four digits, everything else as text; nothing is taken as HTML.
    caption : str
    """

    header: Sequence[str]
    rows: Sequence[Sequence[object]]
    caption: str = ""


def visible_table(diagnosis: Diagnosis) -> str:
    """Return the smallest constant faults that a fitted monitor sees as HTML; nothing if unknown."""
    check = diagnosis.fit_check
    if check is None or not check.visible:
        return ""
    caption = (
        "The smallest constant faults that this monitor detects in nine of ten cases. Deviations: standard deviations "
        f"of the channel in the fit. Detectable: in alarm while it lasts, at {DETECTABLE:g} deviations or fewer."
    )
    rows = [list(map(escape, one.cells)) for one in check.visible[:MAX_ROWS]]
    return html_table([capital(name) for name in HEADER], rows, caption=caption)


def text_table(table: Table) -> str:
    """Return a user's table as HTML, escaped."""
    rows = [[_cell(value) for value in row] for row in table.rows]
    return html_table([escape(h) for h in table.header], rows, caption=escape(table.caption))


def html_table(header: Sequence[str], rows: Iterable[Sequence[str]], *, caption: str = "", kind: str = "") -> str:
    """Return a table from cells that are HTML already; a cell that starts with ``<td`` or ``<th`` is kept whole.

    Of the kind ``"cards"``, each row becomes a list of names and values on a narrow screen.
    """
    head = "".join(f'<th scope="col">{cell}</th>' for cell in header)
    names = header if kind == "cards" else [""] * len(header)
    body = "".join("<tr>" + "".join(map(_wrapped, row, names)) + "</tr>\n" for row in rows)
    title = f'<p class="caption">{caption}</p>' if caption else ""
    return (
        f'{title}<div class="scroll"><table class="{kind}"><thead><tr>{head}</tr></thead>\n'
        f"<tbody>{body}</tbody></table></div>"
    )


def alarm_table(diagnosis: Diagnosis) -> str:
    """Return the table of alarms, or a sentence without any."""
    if not diagnosis.alarms:
        return '<p class="muted">No alarm was raised.</p>'
    rows = []
    main = diagnosis.main_alarm
    for k, alarm in longest_alarms(diagnosis.alarms, MAX_ROWS):
        named = [c for c in alarm.candidates if np.isfinite(c.score)]
        best, following = (named + [None, None])[:2]
        mark = ' <span class="tag">main</span>' if alarm is main and len(diagnosis.alarms) > 1 else ""
        rows.append(
            [
                f"{k}{mark}",
                *map(time_cell, alarm_times(alarm, diagnosis.clock)),
                _name(best.name if best else "not isolated"),
                _num(_weight(best)) if best else _num("–"),
                _name(tied_name(tuple(named), 2) if following else "–"),
                _num(_weight(following)) if following else _num("–"),
                _name(alarm.word.kind if alarm.word else "–"),
            ]
        )
    probable = any(c.probability is not None for alarm in diagnosis.alarms for c in alarm.candidates)
    weight = "Probability" if probable else "Score"
    header = ["Alarm", *ALARM_TIMES, "Most likely", weight, "Next", weight, "How sure"]
    return html_table(header, rows, kind="cards") + left_out_note(diagnosis)


def left_out_note(diagnosis: Diagnosis) -> str:
    """Return the paragraph below a table of alarms about those left out; empty if all are shown."""
    text = left_out_text(diagnosis.alarms, MAX_ROWS)
    return f'<p class="muted">{escape(text.replace("...", "…"))}.</p>' if text else ""


def alarm_times(alarm: Alarm, clock: Clock) -> list[str]:
    """Return the cells of the beginning, raising and end of an alarm."""
    began = alarm.began
    if began is None:
        start = "at or before it was raised"
    elif began.earliest is None:
        start = f"at or before {clock.at(began.latest)}"
    else:
        start = f"{clock.at(began.earliest)} to {clock.at(began.latest)}"
    return [start, clock.at(alarm.raised), "end of recording" if alarm.ended is None else clock.at(alarm.ended)]


def _weight(candidate: Candidate) -> str:
    """Return the probability of a candidate if there is one, else its score."""
    return score(candidate.score) if candidate.probability is None else number(candidate.probability, 3)


def candidate_table(diagnosis: Diagnosis) -> str:
    """Return every candidate of the main alarm with its score, best first; empty without candidates."""
    candidates = diagnosis.candidates
    if not candidates:
        return ""
    by_code = diagnosis.naming.codes is not None
    matched = diagnosis.match is not None
    probable = any(c.probability is not None for c in candidates)
    scored_alone = by_code or matched or not diagnosis.naming.signatures
    sized = any(c.sizes for c in candidates)
    rows = []
    for k, c in ranked(candidates):
        long = c.score if c.probability is None else c.probability
        width = f"{100 * long:.1f}" if np.isfinite(long) else "0"
        bar = f'<td class="bar"><span style="--w:{width}%"></span></td>'
        numbers = [score(c.score)] if scored_alone else [score(c.score), angle(c.score), score(c.distance)]
        if probable:
            values = (c.probability, c.p_value, c.pair_p_value)
            numbers = ["–" if value is None else number(value, 3) for value in values]
        if matched:
            numbers += [number(c.ratio), "before the window" if c.arrival is None else diagnosis.clock.at(c.arrival)]
        sizes = [escape(sizes_text(c.sizes) or "–")] if sized else []
        rows.append([str(k), _name(c.name), bar, *map(_num, [*numbers, *sizes])])
    header = ["Rank", "Fault", "", *(("Probability", "p alone", "p against the first") if probable else ("Score",))]
    header += ["2 ln likelihood ratio", "Arrived"] if matched else []
    header += [] if scored_alone or probable else ["Angle to signature", "Distance"]
    header += ["Estimated size"] if sized else []
    title = "Candidates of the main alarm" if len(diagnosis.alarms) > 1 else "Candidates"
    more = len(rows) - SHOWN_FAULTS
    if more < 2:
        return html_table(header, rows, caption=title)
    rest = html_table(header, rows[SHOWN_FAULTS:])
    return (
        f"{html_table(header, rows[:SHOWN_FAULTS], caption=f'{title}: the first {SHOWN_FAULTS}')}"
        f'<details class="more"><summary>{more} more candidates, with lower scores</summary>{rest}</details>'
    )


def learnt_faults_html(diagnosis: Diagnosis) -> str:
    """Return the table of learnt faults, with the angle of the main alarm to each."""
    table = LearntFaults(diagnosis.naming.learnt_faults)
    if not table:
        return ""
    header, rows = table.cells()
    main = diagnosis.main_alarm
    matches = {m.fault: m for m in main.learnt} if main is not None else {}
    cells = [[f'<td class="name">{escape(row[0])}</td>', *map(escape, row[1:])] for row in rows]
    if matches:
        header = [*header, "angle to main alarm", "angle allowed"]
        for row, learnt in zip(cells, table, strict=True):
            one = matches.get(learnt.name)
            row += ["–", "–"] if one is None else [f"{one.angle:.2g}°", f"{one.allowed:.2g}°"]
    text = (
        "Learnt from recordings of these faults. A cone contains the direction with 95 % confidence; one recording "
        "cannot show how much the next occurrence will differ."
    )
    return f"<h3>Learnt faults</h3><p>{text}</p>{html_table([one[:1].upper() + one[1:] for one in header], cells)}"


def structure_table(generator: ResidualGenerator) -> str:
    """Return the residuals, or members of a bank, that respond to each fault: one row per fault."""
    if not generator.faults:
        return '<p class="muted">The plant has no faults.</p>'
    names, fires_for, what = generator.residuals, generator.structure, "residuals"
    if generator.codes is not None:
        names, fires_for, what = tuple(m.name for m in generator.members), generator.codes, "members"
    if len(generator.faults) > SHOWN_FAULTS:
        return _structure_in_short(generator.faults, names, fires_for, what)
    rows = []
    for j, fault in enumerate(generator.faults):
        cells = [
            '<td class="on" title="responds">●</td>' if fires else '<td class="off" title="stays zero">·</td>'
            for fires in fires_for[:, j]
        ]
        rows.append([f'<th scope="row">{escape(fault)}</th>', *cells])
    header = ["Fault", *(f"<span>{escape(name)}</span>" for name in names)]
    kind = "matrix upright" if len(names) > 8 else "matrix"
    return html_table(
        header, rows, caption=f"Which {what} respond to which fault (● responds, · stays zero)", kind=kind
    )


def _structure_in_short(faults: Sequence[str], names: Sequence[str], fires_for: NDArray[np.bool_], what: str) -> str:
    """Return the structure of many faults as text, those with the same pattern in one row."""
    patterns: dict[bytes, list[int]] = {}
    for j in range(len(faults)):
        patterns.setdefault(fires_for[:, j].tobytes(), []).append(j)
    if len(patterns) == 1:
        which = _pattern_text(fires_for[:, 0], names, what)
        return f"<p>All {len(faults)} faults move the same {what}: {escape(which)}. They differ in how.</p>"
    rows = []
    for members in sorted(patterns.values(), key=len, reverse=True):
        text = _pattern_text(fires_for[:, members[0]], names, what)
        rows.append([_name(some((faults[j] for j in members), SHOWN_FAULTS)), escape(text)])
    caption = f"Which {what} respond to which fault: {len(faults)} faults in {len(rows)} patterns"
    header = ["Faults", capital(what)]
    if len(rows) <= SHOWN_FAULTS:
        return html_table(header, rows, caption=caption)
    return f'<details class="more"><summary>{escape(caption)}</summary>{html_table(header, rows)}</details>'


def _pattern_text(fires: NDArray[np.bool_], names: Sequence[str], what: str) -> str:
    """Describe a pattern by the fired or by the silent ones, whichever is shorter."""
    on, off = ([name for name, one in zip(names, fires, strict=True) if bool(one) == kind] for kind in (True, False))
    if not on:
        return "none"
    if not off:
        return f"all {len(names)} {what}"
    return some(on) if len(on) <= len(off) else f"all {what} but {some(off)}"


def similarity_table(labels: Sequence[str], values: NDArray[np.float64], observed: NDArray[np.float64] | None) -> str:
    """Return the heat map of the cosines between signatures, with the observed residual as last row.

    The swatches are the colours of :func:`residua.report.pictures.direction_picture`.
    """
    header = ["Signature", *(f'<abbr title="{escape(name)}">{k}</abbr>' for k, name in enumerate(labels, 1))]
    rows = []
    for k, (name, line) in enumerate(zip(labels, values, strict=True), 1):
        swatch = f'<span class="swatch c{(k - 1) % 8}"></span>'
        rows.append([f'<th scope="row">{swatch}<b>{k}</b> {escape(name)}</th>', *map(_heat, line)])
    if observed is not None:
        rows.append(
            [
                '<th scope="row"><span class="swatch observed"></span><i>observed residual, main alarm</i></th>',
                *map(_heat, observed),
            ]
        )
    return html_table(header, rows, kind="matrix heat")


def evidence_html(evidence: Evidence) -> str:
    """Return the checks of a design as tables and lists."""
    poles = [
        [label, _num(_poles(values))]
        for label, values in (
            ("Poles", evidence.poles),
            ("Poles asked for", evidence.requested_poles),
            ("Fixed (invariant zeros, no gain moves them)", evidence.fixed_poles),
        )
        if len(values)
    ]
    gains = [[f"Largest gain from {escape(k)}, relative", _num(number(v, 2))] for k, v in evidence.decoupling.items()]
    conditions = [[escape(k), _num(number(v, 3))] for k, v in evidence.conditions.items()]
    parts = []
    if poles or gains or conditions:
        parts.append(html_table(["Check", "Value"], [*poles, *gains, *conditions]))
    if evidence.ranks:
        ranks = [[escape(k), _num(str(d.rank)), *map(_num, _singular(d))] for k, d in evidence.ranks.items()]
        header = ["Rank decision", "Rank", "Singular values kept", "Counted as zero", "Tolerance", "Gap"]
        parts.append(html_table(header, ranks))
    for title, lines in (("Notes", evidence.notes), ("References", evidence.references)):
        if lines:
            parts.append(f"<h4>{title}</h4><ul>{''.join(f'<li>{escape(x)}</li>' for x in lines)}</ul>")
    return "\n".join(parts) or '<p class="muted">None was recorded.</p>'


def _singular(decision: RankDecision) -> tuple[str, str, str, str]:
    kept, dropped = ([number(float(s), 3) for s in part] for part in (decision.kept, decision.dropped))
    gap = "clear" if decision.is_clear else "narrow"
    return _cut(kept) or "none", _cut(dropped) or "none", number(decision.tolerance, 2), gap


def _poles(values: NDArray[np.complex128]) -> str:
    return _cut([escape(format_pole(p)).replace("-", "−") for p in values])


def _cut(entries: list[str]) -> str:
    more = len(entries) - MAX_ENTRIES
    return ", ".join(entries[:MAX_ENTRIES]) + (f" and {more} more" if more > 0 else "")


def _heat(value: float) -> str:
    if not np.isfinite(value):
        return '<td class="heat-none">–</td>'
    return f'<td style="--v:{value:.3f}">{value:.2f}</td>'


def _num(text: str) -> str:
    return f'<td class="num">{text}</td>'


def time_cell(text: str) -> str:
    """Return the cell of a time, or of an interval in two lines; never broken within a time."""
    return f'<td class="num time">{text.replace(" to ", " to <br>")}</td>'


def _name(text: str) -> str:
    return f'<td class="name">{escape(text)}</td>'


def _cell(value: object) -> str:
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, (int, np.integer)):
        return _num(f"{int(value):,}")
    if isinstance(value, (float, np.floating)):
        return _num(number(float(value)))
    return f"<td>{escape('' if value is None else value)}</td>"


def _wrapped(cell: str, name: str) -> str:
    whole = cell if cell.startswith(("<td", "<th")) else f"<td>{cell}</td>"
    empty = " data-empty" * whole.endswith(">–</td>")
    return whole.replace("<td", f'<td data-name="{name}"{empty}', 1) if name else whole
