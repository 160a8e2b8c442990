"""Parts of a page about one diagnosis or one filter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.statement import capital, size_text
from residua.decide.word import EITHER
from residua.recording.clock import length
from residua.report.charts import by_interest, residual_unit
from residua.report.choosing import SHOWN_FAULTS, look_alikes, shown_groups
from residua.report.codes import code_alarm_table, code_table, present_table
from residua.report.contributions import contribution_html, inside_band, reconstruction_html
from residua.report.figures import band_text, charts_html
from residua.report.pictures import direction_picture
from residua.report.signatures import Signatures, judged_signatures
from residua.report.tables import (
    ALARM_TIMES,
    alarm_table,
    alarm_times,
    candidate_table,
    evidence_html,
    html_table,
    learnt_faults_html,
    similarity_table,
    structure_table,
    visible_table,
)
from residua.report.text import escape
from residua.report.verdict import BEGAN_RULE, Verdict, verdict
from residua.words import counted, listing, number, percent, score, some

if TYPE_CHECKING:
    from residua.design.core.generator import ResidualGenerator
    from residua.monitor.diagnosis import Diagnosis

_KINDS = {"sensor": "sensor", "actuator": "actuator", "component": "component"}
#: Cosine from which on signatures are said to look alike, and clusters of them that are listed.
ALIKE = 0.98
_CLUSTERS = 6
_MARKS = {"fault": "⚠", "none": "✓", "undecided": "?", "cannot tell": "?", "outside": "?"}


def summary_html(entries: Sequence[tuple[int, str, Diagnosis, tuple[str, ...] | None]]) -> str:
    """Return the summary table of several diagnoses: section number, heading, diagnosis, real faults."""
    truth = any(actual is not None for *_, actual in entries)
    rows = []
    for k, heading, diagnosis, actual in entries:
        v = verdict(diagnosis)
        best = diagnosis.candidates[0] if diagnosis.candidates else None
        reading = diagnosis.main_alarm.reading if diagnosis.main_alarm else None
        unread = reading is not None and not reading.named
        if best:
            named = best.name
        elif v.present:
            named = listing(" or ".join(group) for group in v.present)
        elif reading is not None:
            named = "a fault, not identified" if reading.possible else "several faults, or an unknown one"
        else:
            named = "a fault, not isolated" if v.kind == "fault" else v.headline.rstrip(".")
        row = [f'<a href="#s{k}">{escape(heading or f"Diagnosis {k}")}</a>']
        if truth:
            row.append("–" if actual is None else escape(listing(actual)) or "none")
        several = actual is not None and len(actual) > 1 and unread  # as the verdict says
        faults = actual if several and actual else best.faults if best else ()
        if actual and v.present:  # right if each is named, and nothing else
            faults = actual if _just_these(actual, v.present) else ("",)
        row.append(f"{escape(named)}{_agreement(actual, faults, v.kind == 'fault')}")
        times = alarm_times(diagnosis.main_alarm, diagnosis.clock)[:2] if diagnosis.main_alarm else ["–", "–"]
        row += [
            f'<td class="num">{cell}</td>'
            for cell in (
                *times,
                score(best.score if best.probability is None else best.probability) if best else "–",
            )
        ]
        rows.append([*row, escape(v.confidence) or "–"])
    header = [
        "Case",
        *(["Actual fault"] if truth else []),
        "Diagnosis",
        *ALARM_TIMES[:2],
        "Score",
        "How sure",
    ]
    return f'<section class="summary"><h2>Summary</h2>{html_table(header, rows, kind="cards")}</section>'


def _just_these(actual: tuple[str, ...], groups: tuple[tuple[str, ...], ...]) -> bool:
    """Tell whether every actual fault is in a named group, and each of those contains one."""
    return all(any(f in g for g in groups) for f in actual) and all(set(g) & set(actual) for g in groups)


def _agreement(actual: tuple[str, ...] | None, named: tuple[str, ...], alarm: bool) -> str:
    """Return a mark for a right or wrong diagnosis, if the truth is known."""
    if actual is None:
        return ""
    if set(actual) & set(named) or (not actual and not alarm):
        return ' <span class="tag right">✓ right</span>'
    word = "false alarm" if not actual else "wrong" if named else "missed"
    return f' <span class="tag wrong">✗ {word}</span>'


def verdict_html(found: Verdict, details: str) -> str:
    """Return a verdict as a box: its headline, and HTML below it."""
    unsaid = found.confidence and found.confidence not in found.headline
    tag = f' <span class="tag">{escape(found.confidence)}</span>' if unsaid else ""
    mark = f'<span class="mark" aria-hidden="true">{_MARKS[found.kind]}</span>'
    headline = f'<p class="headline">{mark} {escape(found.headline)}{tag}</p>'
    return f'<div class="verdict {found.kind.replace(" ", "-")}">{headline}{details}</div>'


def diagnosis_html(diagnosis: Diagnosis, charts: dict[str, Any], *, number: int, filter_number: int) -> str:
    """Return verdict, charts, alarms and directions of one diagnosis.

    Parameters
    ----------
    diagnosis : Diagnosis
    charts : dict
        From :func:`residua.report.charts.chart_data`.
    number : int
        Position of the charts in the page's data.
    filter_number : int
        Number of the filter on the page, 0 when it has only one.
    """
    v = verdict(diagnosis)
    tabled = diagnosis.fit_check.could_have_seen if diagnosis.fit_check else ()
    sentences = "".join(f"<li>{escape(s)}</li>" for s in v.sentences if s not in tabled)
    by_code = diagnosis.naming.codes is not None
    link = f'<p><a href="#f{filter_number}">Filter {filter_number}, its structure and evidence</a></p>'
    return "\n".join(
        [
            verdict_html(v, f"<ul>{sentences}</ul>"),
            look_table(diagnosis),
            _recording(diagnosis),
            charts_html(diagnosis, charts, number),
            contribution_html(diagnosis),
            reconstruction_html(diagnosis),
            "<h3>Alarms</h3>",
            code_alarm_table(diagnosis) if by_code and diagnosis.alarms else alarm_table(diagnosis),
            present_table(diagnosis),
            candidate_table(diagnosis),
            f'<p class="muted">{escape(v.rules)}</p>' if v.rules else "",
            f'<p class="muted">{escape(BEGAN_RULE)}</p>' if any(a.began for a in diagnosis.alarms) else "",
            code_table(diagnosis) if by_code else _directions(diagnosis),
            learnt_faults_html(diagnosis),
            _residual_table(diagnosis),
            visible_table(diagnosis),
            link if filter_number else "",
        ]
    )


def _recording(diagnosis: Diagnosis) -> str:
    n = len(diagnosis.time)
    if n == 0:
        return '<p class="recording">The recording is empty.</p>'
    decided, clock, check = int(diagnosis.decided.sum()), diagnosis.clock, diagnosis.fit_check
    where = f"Recording <b>{escape(diagnosis.recording.source)}</b>" if diagnosis.recording.source else "Recording"
    parts = [
        f"{where}: {n:,} samples from {clock.at(float(diagnosis.time[0]))} to {clock.at(float(diagnosis.time[-1]))}"
        f"{_local(diagnosis)}, step {length(diagnosis.generator.dt)}, {length(float(np.ptp(diagnosis.time)))} in all; "
        f"{decided:,} judged ({percent(decided, n)}).",
        _missing(diagnosis),
        *([escape(f"{capital(check.false_alarms)}.")] if check and check.false_alarms else []),
        *(escape(note) for note in diagnosis.notes),
    ]
    return '<p class="recording">' + "<br>".join(parts) + "</p>"


def _local(diagnosis: Diagnosis) -> str:
    """Return the clock of the times."""
    clock = diagnosis.clock
    if clock.moment is None:
        return ""
    return f" (local times of the recording, UTC{clock.zone})" if clock.zone else " (clock of the recording)"


def _missing(diagnosis: Diagnosis) -> str:
    if not diagnosis.n_missing:
        return "No sample has missing values."
    share = percent(diagnosis.n_missing, len(diagnosis.time))
    times = "once" if diagnosis.recording.resets == 1 else f"{diagnosis.recording.resets:,} times"
    restart = (
        f"The filter was restarted {times} after longer gaps."
        if diagnosis.recording.resets
        else "No restart was needed."
    )
    how = "used the remaining values" if diagnosis.recording.predicted else "held the last values"
    return (
        f"<b>{diagnosis.n_missing:,} samples ({share}) have missing values:</b> there the filter {how}, and the charts "
        f"show no residual and no decision. {restart}"
    )


def _directions(diagnosis: Diagnosis) -> str:
    generator = diagnosis.generator
    known = judged_signatures(diagnosis)
    if not known.labels:
        return ""
    if generator.n_residuals < 2:
        return '<h3>Directions</h3><p class="muted">One residual has no direction: it detects but cannot isolate.</p>'
    observed = observed_residual(diagnosis, known)
    total = len(known.labels)
    if total > SHOWN_FAULTS:
        alike = look_alikes(known.labels, known.similarity(), ALIKE)
        if observed is None or not diagnosis.groups:
            return f"<h3>Directions</h3>{_alike_text(alike, total)}"
        known = known.only(shown_groups(diagnosis))
    correlation = None if observed is None else known.correlation(observed)
    picture = direction_picture(generator.residuals, known.bases, observed)
    text = (
        "Cosine of the smallest angle between every two signatures (the largest principal cosine): 1 means that they "
        "share a direction, 0 that they are at right angles."
    )
    if not diagnosis.groups:
        text = "This monitor does not isolate; these are the signatures it would judge by. " + text
    elif not diagnosis.naming.signatures:
        text = f"This monitor does not name faults by direction; the table shows how well it could. {text}"
    if known.whitened:
        text += " Residuals are compared after whitening by their fault-free covariance."
    if any(known.steady):
        text += (
            " For some faults the signature is the direction that a constant fault settles to; while the fault "
            "changes, the residual can leave it."
        )
    if observed is not None:
        text += " The last row compares the mean residual over the main alarm with each signature."
    few = ""
    if total > SHOWN_FAULTS:
        few = _alike_text(alike, total)
        text = f"The {len(known.labels)} of {total} groups with the best scores in the main alarm. {text}"
    return (
        f'<h3>Directions</h3><p>{text}</p><div class="pair">{picture}'
        f"{similarity_table(known.labels, known.similarity(), correlation)}</div>{few}"
    )


def _alike_text(alike: list[list[str]], total: int) -> str:
    """Describe the signatures that look alike."""
    least = f"cosine {ALIKE:g} or more"
    if not alike:
        return f"<p>No two of the {total} groups have signatures that look alike ({least}).</p>"
    items = "".join(f"<li>{escape(some(cluster, 8))}</li>" for cluster in alike[:_CLUSTERS])
    more = len(alike) - _CLUSTERS
    rest = f"<li>and {more} more clusters</li>" if more > 0 else ""
    lead = f"Of {total} groups these have signatures that look alike ({least}, one to the next)"
    return f"<p>{lead}:</p><ul>{items}{rest}</ul>"


def observed_residual(diagnosis: Diagnosis, known: Signatures) -> NDArray[np.float64] | None:
    """Return the mean whitened residual over the main alarm; ``None`` without one."""
    alarm = diagnosis.main_alarm
    if alarm is None:
        return None
    block = diagnosis.residuals[alarm.start : alarm.stop]
    block = block[np.isfinite(block).all(axis=1)]
    if not len(block):
        return None
    mean = known.whitening @ (block.mean(axis=0) - diagnosis.test.center)
    return mean if np.linalg.norm(mean) > 0 else None


def _residual_table(diagnosis: Diagnosis) -> str:
    rows = []
    first = diagnosis.alarms[0].start if diagnosis.alarms else len(diagnosis.time)
    outside = 1 - inside_band(diagnosis, 0, first)
    for i in by_interest(diagnosis):
        name = diagnosis.generator.residuals[i]
        column = diagnosis.residuals[:, i]
        seen = column[np.isfinite(column)]
        cells = (
            diagnosis.test.center[i],
            diagnosis.test.band[i],
            *((seen.min(), seen.max()) if seen.size else (np.nan,) * 2),
        )
        rows.append(
            [escape(name), escape(residual_unit(diagnosis, name)) or "–"]
            + [f'<td class="num">{number(float(c))}</td>' for c in cells]
            + [f'<td class="num">{"–" if np.isnan(outside[i]) else percent(round(1e4 * outside[i]), 10_000)}</td>']
        )
    header = [
        "Residual",
        "Unit",
        "Centre" if diagnosis.test.horizon else "Fault-free mean",
        "Normal range (±)",
        "Smallest seen",
        "Largest seen",
        "Outside it before any alarm",
    ]
    settings = [[escape(key), escape(value)] for key, value in diagnosis.settings.items()]
    how = html_table(["Setting", ""], settings) if settings else ""
    band = f'<p class="muted">Normal range: {escape(band_text(diagnosis))}.</p>'
    return (
        f"<details><summary>Settings and residuals in numbers</summary>{how}{html_table(header, rows)}{band}</details>"
    )


def filter_html(generator: ResidualGenerator, *, number: int, several: bool, used_by: str) -> str:
    """Return the facts of a filter, its structure and its evidence."""
    plant = generator.plant
    title = f"Filter {number}: {generator.method}" if several else "The filter"
    used = f"<p>Used in: {escape(used_by)}.</p>" if used_by else ""
    bank = f"{counted(len(generator.members), 'member')}, " if generator.codes is not None else ""
    states, residuals = counted(generator.system.n_states, "state"), counted(generator.n_residuals, "residual")
    facts = [
        ("Method", generator.method),
        ("Filter", f"{bank}{states}, {residuals}"),
        ("Sample step", length(generator.dt) if generator.dt else "continuous"),
        ("Plant", f"{plant.name}, {plant.n_states} states"),
        ("Inputs", some(plant.inputs, 20) or "none"),
        ("Outputs", some(plant.outputs, 20)),
        ("Disturbances in the model", some(plant.disturbances, 20) or "none"),
    ]
    table = html_table(["Property", ""], [[escape(key), escape(value)] for key, value in facts])
    return (
        f'<section id="f{number}"><h2>{escape(title)}</h2>{used}{table}{structure_table(generator)}'
        f"<details{'' if several else ' open'}><summary>Evidence: checks of the design</summary>"
        f"{evidence_html(generator.evidence)}</details></section>"
    )


def look_table(diagnosis: Diagnosis) -> str:
    """Return the checks for named faults, as a table; empty without."""
    main, plant = diagnosis.main_alarm, diagnosis.generator.plant
    if main is None:
        return ""
    groups = [*diagnosis.named, *(main.word.faults if main.word and main.word.kind == EITHER else ())]
    faults = list(dict.fromkeys(name for group in groups for name in group if name in plant.faults))
    if not faults:
        return ""
    shown = [plant.fault_list[plant.faults.index(name)] for name in faults[:SHOWN_FAULTS]]
    size_of = {size.fault: size for size in main.sizes}
    sizes = [size_text(size_of[fault.name]) if fault.name in size_of else "" for fault in shown]
    columns: list[tuple[str, list[str]]] = [
        ("Fault", [f'<td class="name">{escape(fault.name)}</td>' for fault in shown]),
        ("Component", [escape(fault.component) for fault in shown]),
        ("Kind", [_KINDS.get(fault.kind, escape(fault.kind)) for fault in shown]),
        ("Description", [escape(fault.description) for fault in shown]),
        ("What to check", [escape(fault.check) for fault in shown]),
        ("Estimated size", [escape(size) for size in sizes]),
    ]
    kept = [(name, cells) for name, cells in columns if any(cells)]
    rows = [[cell or "–" for cell in row] for row in zip(*(cells for _, cells in kept), strict=True)]
    more = len(faults) - len(shown)
    note = f'<p class="muted">… and {more} more, which this monitor cannot tell from these.</p>' if more else ""
    table = html_table([name for name, _ in kept], rows, kind="cards")
    return f"<h3>What to look at</h3>{table}{note}"
