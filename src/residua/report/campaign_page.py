"""Page of a campaign: false alarms, detections, delays and named faults, with the settings to repeat it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from residua.files import write_text
from residua.report.drawings import COLOURS, Curve, curves
from residua.report.page import document, footer, paragraphs
from residua.report.tables import html_table
from residua.report.text import escape, safe_json
from residua.validate.intervals import wilson
from residua.words import counted, number

if TYPE_CHECKING:
    from residua.validate.campaign_result import Campaign
    from residua.validate.delays import Delays
    from residua.validate.figure_table import FigureTable
    from residua.validate.separation import Roc
    from residua.validate.size_fit import DetectionProbability

#: Points of a fitted curve.
_POINTS = 60
#: Points of a step function that are drawn.
_STEPS = 150


def write_campaign_page(campaign: Campaign, path: str | Path, *, title: str | None = None) -> Path:
    """Write the page of a campaign.

    It has the false alarms, and for each fault detections, delays, names, the curves of detections against
    false alarms and the probability of detection by size, each with its confidence interval; and seed, versions and
    settings, by which it can be repeated.

    Parameters
    ----------
    campaign : Campaign
    path : str or Path
        The HTML file to write, in a folder that exists.
    title : str, optional
        ``"<plant>: fault campaign"`` when omitted.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    FileFormatError
        If the folder does not exist, the path is a folder, or writing there is not allowed.
    """
    title = f"{campaign.plant}: fault campaign" if title is None else title
    body = [
        f"<header><h1>{escape(title)}</h1></header>",
        _headline(campaign),
        _false_alarms(campaign),
    ]
    if campaign.cases:
        body += [
            f"<h2>Detection</h2>{paragraphs(_ABOUT_DETECTION)}{_table(campaign.table())}",
            f"<h2>Delays</h2>{paragraphs(_ABOUT_DELAYS)}{_table(campaign.delays())}",
            _pictures(campaign),
            f"<h2>Named faults</h2>{paragraphs(_ABOUT_NAMES)}{_confusion(campaign)}",
        ]
    body += [_settings(campaign), footer()]
    return write_text(path, document(title, "\n".join(body), safe_json({"diagnoses": []})))


_ABOUT_DETECTION = (
    "A run counts as detected if an alarm stands at any sample from the onset on. By chance: the share of runs that a "
    "false alarm alone would have counted; only detections above it are evidence. Named: the share of detected runs "
    "that name the fault's own group."
)
_ABOUT_DELAYS = (
    "Seconds from the onset to the first sample in alarm. Runs without an alarm are censored at their end: a quantile "
    "above the share of detected runs is infinite here, and longer runs would show it."
)
_ABOUT_NAMES = (
    "Shares of all runs of a case, by the fault that the longest alarm from the onset on is attributed to. Unknown: an "
    "alarm attributed to no fault; none: no alarm."
)


def _headline(campaign: Campaign) -> str:
    rate = campaign.false_alarm_rate()
    text = (
        f"{counted(campaign.runs, 'run')} of {campaign.samples:,} samples for each of "
        f"{counted(len(campaign.cases), 'case')}. Without a fault {rate} of the samples were in alarm."
    )
    sure = f"Brackets hold intervals of {100 * campaign.confidence:g} % confidence."
    remarks = "".join(f"<li>{escape(line)}</li>" for line in (sure, *campaign.notes))
    return f'<div class="verdict none"><p class="headline">{escape(text)}</p><ul>{remarks}</ul></div>'


def _false_alarms(campaign: Campaign) -> str:
    f = campaign.figures
    rows = [
        ("Fault-free samples with a decision", f"{int(f.decided.sum()):,}"),
        ("Fraction of them in alarm", str(campaign.false_alarm_rate())),
        ("False alarms raised", f"{int(f.raised.sum()):,}"),
        ("Mean time between false alarms", f"{campaign.time_between_false_alarms()} s"),
    ]
    return f"<h2>False alarms</h2>{html_table(['', ''], [[escape(a), escape(b)] for a, b in rows])}"


def _table(table: FigureTable) -> str:
    header = [escape(name[:1].upper() + name[1:]) for name in table.header]
    return html_table(header, [[escape(cell) for cell in row] for row in table.cells()])


def _confusion(campaign: Campaign) -> str:
    """Return the shares as a heat map; the intervals are shown on hover."""
    table = campaign.confusion()
    rows = []
    for case, row in zip(campaign.cases, table.rows, strict=True):
        cells = [
            f'<td style="--v:{value.value:.3f}" title="{escape(str(value))}">{value.value:.2f}</td>'
            for value in row[3:]
        ]
        rows.append([f'<th scope="row">{escape(case.name)}</th>', *cells])
    header = ["Actual fault", *(escape(name) for name in table.header[3:])]
    return html_table(header, rows, kind="matrix heat")


def _pictures(campaign: Campaign) -> str:
    """Return the pictures of each scenario: detections over time, against false alarms, and by size."""
    out = ["<h2>Curves</h2>"]
    fits = campaign.detection_probabilities()
    for fit, scenario in zip(fits, dict.fromkeys(case.scenario for case in campaign.cases), strict=True):
        which = [c for c, case in enumerate(campaign.cases) if case.scenario == scenario]
        names = [f"size {number(campaign.cases[c].size)}" for c in which]
        delays = [campaign.delay(c) for c in which]
        rocs = [campaign.roc(c) for c in which]
        pictures = [
            _delay_picture(names, delays),
            _roc_picture(names, rocs),  # pyright: ignore[reportArgumentType]
            _size_picture(fit, campaign),
        ]
        areas = "; ".join(f"{name}: {roc.area}" for name, roc in zip(names, rocs, strict=True))  # pyright: ignore
        text = [f"Area under the curve of detections against false alarms: {areas}."]
        if len(fit.sizes) > 1:
            text.append(f"Probability of detection by size: {fit}.")
        heading = escape(f"{fit.fault}, {fit.shape}")
        key = _key(names) if len(names) > 1 else ""
        out.append(f'<h3>{heading}</h3>{key}<div class="pair">{"".join(pictures)}</div>{paragraphs(text)}')
    return "\n".join(out)


def _key(names: list[str]) -> str:
    """Return the legend of the curves."""
    items = "".join(
        f'<li><span class="swatch c{k % COLOURS}"></span>{escape(name)}</li>' for k, name in enumerate(names)
    )
    return f'<ul class="legend key">{items}</ul>'


def _delay_picture(names: list[str], delays: list[Delays]) -> str:
    lines = []
    for name, one in zip(names, delays, strict=True):
        kept = np.unique(np.linspace(0, len(one.time) - 1, min(len(one.time), _STEPS)).astype(int))
        time, share = np.r_[0.0, one.time[kept]], np.r_[0.0, 1 - one.undetected[kept]]
        lines.append(Curve(name, time, share, steps=True))
    return curves(lines, title="Detected so far", x_label="time since the onset [s]", y_label="share of runs", top=1.0)


def _roc_picture(names: list[str], rocs: list[Roc]) -> str:
    lines = [Curve("", [0.0, 1.0], [0.0, 1.0])]
    for name, one in zip(names, rocs, strict=True):
        lines.append(Curve(name, one.false_alarms, one.detections))
    label = "share of runs with a false alarm"
    return curves(lines, title="Over all thresholds", x_label=label, y_label="share detected", top=1.0)


def _size_picture(fit: DetectionProbability, campaign: Campaign) -> str:
    if len(fit.sizes) < 2:
        return ""
    seen = [wilson(int(k), int(n), campaign.confidence) for k, n in zip(fit.detected, fit.runs, strict=True)]
    ends = [one.low for one in seen], [one.high for one in seen]
    lines = [Curve("runs", fit.sizes, [one.value for one in seen], *ends, points=True)]
    if fit.beta is not None:
        size = np.geomspace(fit.sizes[0], fit.sizes[-1], _POINTS)
        middle, low = fit.probability(size)
        lines += [Curve("fitted", size, middle), Curve("lower 95 % bound", size, low)]
        lines.append(Curve("", [fit.sizes[0], fit.sizes[-1]], [0.9, 0.9]))
    unit = "size of the fault"
    return curves(lines, title="Probability of detection", x_label=unit, y_label="probability", log=True, top=1.0)


def _settings(campaign: Campaign) -> str:
    rows = [
        ("seed", str(campaign.seed)),
        ("runs of each case", f"{campaign.runs:,}"),
        ("samples of a run", f"{campaign.samples:,}"),
        *campaign.settings.items(),
        ("digest of the runs", campaign.draws),
        ("digest of the monitor", campaign.watched),
    ]
    cells = [[escape(name[:1].upper() + name[1:]), escape(value)] for name, value in rows]
    text = "These settings repeat the campaign exactly on the same versions."
    return f"<h2>How it was run</h2>{paragraphs(text)}{html_table(['Setting', ''], cells)}"


__all__ = ["write_campaign_page"]
