"""Places of the charts on a page, and the legend of their colours."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from residua.report.charts import SHOWN_MEMBERS, SHOWN_RESIDUALS
from residua.report.signals import SHOWN_SIGNALS, shown_text, signal_text
from residua.report.text import escape, with_unit
from residua.words import number

if TYPE_CHECKING:
    from residua.monitor.diagnosis import Diagnosis


def charts_html(diagnosis: Diagnosis, charts: dict[str, Any], place: int) -> str:
    """Return the places of the charts of a diagnosis: the test first, then the measurements, then the residuals."""
    if not len(diagnosis.time):
        return ""
    bank = bool(diagnosis.members)
    kinds = ("estimate", "residual", "statistic", "member", "scores", "output", "input")
    figures: dict[str, list[str]] = {kind: [] for kind in kinds}
    for k, chart in enumerate(charts["charts"]):
        figures["estimate" if chart.get("estimate") else chart.get("role", chart["kind"])].append(
            _figure(k, chart, diagnosis)
        )
    shown = 0 if bank else SHOWN_RESIDUALS  # of a bank, the statistics of its members matter
    residuals, members = figures["residual"], figures["member"]
    parts = "groups of residuals" if diagnosis.parts.residuals else "members"
    tests = [
        *figures["statistic"],
        *members[:SHOWN_MEMBERS],
        _behind(members[SHOWN_MEMBERS:], f" more {parts}, which stayed further below their thresholds"),
    ]
    judged = [
        *figures["estimate"],
        *residuals[:shown],
        _behind(residuals[shown:], " residuals" if bank else " more residuals, which stayed closer to their ranges"),
        *figures["scores"],
    ]
    first = "Residuals" if not bank else "Estimates" if figures["estimate"] else ""
    heading = " and ".join(filter(None, [first, "candidates" if figures["scores"] else ""])).capitalize() or "Residuals"
    second = f"<h3>{heading}</h3>{_notes(charts, diagnosis)}{''.join(judged)}" if any(judged) else ""
    return (
        f'<div class="charts" data-diagnosis="{place}"><h3>The test over time</h3>{_key(charts, diagnosis)}'
        f"{''.join(tests)}{_measured(diagnosis, figures)}{second}</div>"
    )


def _measured(diagnosis: Diagnosis, figures: dict[str, list[str]]) -> str:
    """Return the charts of measurements, with the predictions of the model."""
    outputs, inputs = figures["output"], figures["input"]
    if not outputs:
        return ""
    title = "Measured and predicted" if diagnosis.predictions else "Measured"
    return (
        f'<h3>{title}</h3><p class="muted">{escape(signal_text(diagnosis) + shown_text(diagnosis))}</p>'
        f"{''.join(outputs[:SHOWN_SIGNALS])}{_behind(outputs[SHOWN_SIGNALS:], ' more outputs')}"
        f"{_behind(inputs, ' input' + 's' * (len(inputs) > 1))}"
    )


def _figure(k: int, chart: dict[str, Any], diagnosis: Diagnosis) -> str:
    """Return the place of one chart, with its title."""
    bank, what = bool(diagnosis.members), "norm" if diagnosis.test.horizon else "statistic"
    part = "group" if diagnosis.parts.residuals else "member"
    if chart["kind"] == "signal":
        name = chart["label"]
    elif chart["kind"] == "residual":
        fault = chart.get("estimate")
        name = f"Estimated size of {fault}" if fault else f"Residual {chart['label']}"
    else:
        name = {
            "statistic": f"Largest ratio of a {part}'s {what} to its threshold"
            if bank
            else f"{what[0].upper()}{what[1:]} and its threshold",
            "member": f"{part.capitalize()} {chart['label']}: {what}{' of its residual' * (what == 'norm')} "
            "and its threshold",
            "scores": f"Candidate scores{', members that agree' * bool(diagnosis.naming.codes)} "
            "(faded where no alarm stands)",
        }[chart["kind"]]
    title = with_unit(name, chart["unit"])
    log = (
        '<label class="screen"><input type="checkbox" class="log"> logarithmic</label>'
        if chart["kind"] in ("statistic", "member")
        else ""
    )
    empty = all(v is None for series in chart["y"] for v in series)
    nothing = '<p class="muted">No value to draw: all are missing.</p>' if empty else ""
    readout = "" if len(chart["names"]) > 1 or chart["kind"] == "scores" else '<span class="readout"></span>'
    return (
        f'<figure class="chart {chart["kind"]}" data-chart="{k}">'
        f"<figcaption>{escape(title)}{readout}{log}</figcaption>"
        f'<div class="plot" role="img" aria-label="{escape(title)} over time{_limits(chart)}"></div>{nothing}</figure>'
    )


def _limits(chart: dict[str, Any]) -> str:
    """Return the threshold or the normal range of a chart as text, for accessibility."""
    if chart.get("threshold") is not None:
        return f", threshold {number(chart['threshold'])}"
    if chart.get("band"):
        low, high = map(number, chart["band"])
        return f", normal range {low} to {high}"
    return ""


def _behind(figures: list[str], what: str) -> str:
    """Return charts behind a click."""
    if not figures:
        return ""
    return f'<details class="more"><summary>{len(figures)}{what}</summary>{"".join(figures)}</details>'


def band_text(diagnosis: Diagnosis) -> str:
    """Return the meaning of the normal range of a residual."""
    if diagnosis.test.horizon:
        return "a residual outside it takes the norm of all over the threshold, even alone"
    mean = f"averages over {diagnosis.test.averaged} samples" if diagnosis.test.averaged > 1 else "samples"
    if not diagnosis.test.band_share:
        return "fault-free mean ± the threshold; one residual outside it takes the statistic over the threshold"
    outside = round(1 / (1 - diagnosis.test.band_share))
    together = "judges all residuals together"
    if diagnosis.match is not None:
        together = "adds up how well whole responses fit, over many samples and all residuals"
    elif diagnosis.members:
        together = "judges the residuals of a member together"
    return (
        f"fault-free mean ± 3.3 standard deviations (with Gaussian noise, 1 in {outside:,} fault-free {mean} is "
        f"outside). The test {together}, so an alarm can stand while every residual is inside its range"
    )


def _notes(charts: dict[str, Any], diagnosis: Diagnosis) -> str:
    """Return the meaning of the normal ranges, and the number of score lines not drawn."""
    notes = (
        [f"Normal range of one residual: {band_text(diagnosis)}."]
        if any(chart.get("band") for chart in charts["charts"])
        else []
    )
    hidden = sum(chart.get("hidden", 0) for chart in charts["charts"])
    if hidden:
        notes.append(f"Only the candidates with the best scores are drawn; {hidden} more are not.")
    return f'<p class="muted">{escape(" ".join(notes))}</p>' if notes else ""


def _key(charts: dict[str, Any], diagnosis: Diagnosis) -> str:
    """Return the legend of the colours in use, and the binning of samples."""
    entries = [("band", "normal range of one residual")] if any(x.get("band") for x in charts["charts"]) else []
    present = {"alarm": "alarm", "missing": "values missing", "undecided": "not judged (filter settling)"}
    entries += [(kind, text) for kind, text in present.items() if charts["spans"][kind]]
    if charts["spans"]["began"]:
        entries.append(("began", "when it began (95 % confidence)"))
    if charts["onsets"]:
        each = ", of each fault" if any(a.present[1:] for a in diagnosis.alarms) else ""
        entries.append(("onset", f"estimated arrival{each}" if diagnosis.match else f"first over its threshold{each}"))
    items = "".join(f'<li><span class="swatch {kind}"></span>{escape(text)}</li>' for kind, text in entries)
    remarks = []
    if charts["binned"] > 1:
        remarks.append(
            f"Drawn from bins of {charts['binned']} samples: the smallest and the largest value of each bin, so no "
            "extreme is lost. Times in the charts are exact to one bin; verdict and tables use every sample."
        )
    if diagnosis.test.averaged > 1 and not diagnosis.members:
        remarks.append(
            f"The second line of a residual is its average over {diagnosis.test.averaged} samples; the test and the "
            "normal range refer to this average."
        )
    if charts["spans"]["undecided"]:
        remarks.append("The axes of the residuals fit the judged samples; a settling filter may run off them.")
    remark = f'<p class="muted">{" ".join(remarks)}</p>' if remarks else ""
    return (
        f'<ul class="legend key">{items}</ul>{remark}<p class="muted screen"><span class="hover">Drag over a chart to '
        "zoom; double-click to show all. The cursors of all charts move together; the arrow keys move them, too.</span>"
        '<span class="tap">Tap a chart to read its values.</span> '
        '<button type="button" class="all">Show all</button></p>'
    )
