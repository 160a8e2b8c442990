"""Page of an identified model: its quality, the choice of its order, and limits of the data."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.design.core.evidence import format_pole
from residua.files import write_text
from residua.recording.clock import length
from residua.report.charts import MAX_POINTS, over_time
from residua.report.decimate import choose_bins
from residua.report.drawings import stems
from residua.report.page import document, footer, paragraphs
from residua.report.tables import html_table
from residua.report.text import escape, rounded, safe_json, visible
from residua.words import counted, number, some

if TYPE_CHECKING:
    from residua.identify import IdentifiedModel, Prediction

#: Outputs whose curves are shown at once; the others are behind a click.
SHOWN_OUTPUTS = 4
#: Rows by which errors are compared with themselves.
LAGS = 20
#: White errors exceed this many standard deviations of a correlation once in twenty.
_BOUND = 1.96


def write_model_page(
    model: IdentifiedModel,
    recordings: Any,
    path: str | Path,
    *,
    y: ArrayLike | None = None,
    title: str | None = None,
) -> Path:
    """Write the page of an identified model.

    It has the order and what it was compared with, the fit per output, measured against predicted outputs, how the
    prediction errors are correlated in time, the steady gains, and the notes of the report.

    Parameters
    ----------
    model : IdentifiedModel
    recordings : Recording, data frame, path, array, pair (u, y), or a list of these
        What the curves and the correlations are from, best rows that the model is not from. Of several the longest is
        drawn.
    path : str or Path
        The HTML file to write, in a folder that exists.
    y : array_like, shape (time, outputs), optional
        The outputs, where ``recordings`` has the inputs alone.
    title : str, optional
        ``"<plant>: identified model"`` when omitted.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    DataError
        If a recording does not have the channels of the model, or another step.
    FileFormatError
        If the folder does not exist, the path is a folder, or writing there is not allowed.
    """
    report, seen = model.report, model.predict(recordings, y)
    drawn = max(seen, key=lambda one: int(np.isfinite(one.predicted).all(axis=1).sum()))
    title = f"{model.plant.name}: identified model" if title is None else title
    charts = _charts(model, drawn)
    remarks = "".join(f"<li>{escape(line)}</li>" for line in report.remarks)
    body = [
        f"<header><h1>{escape(title)}</h1></header>",
        f'<div class="verdict none"><p class="headline">{escape(_headline(model))}</p><ul>{remarks}</ul></div>',
        _facts(model),
        f"<h2>How good it is</h2>{_fit(model)}",
        _curves(model, drawn, charts),
        _correlations(model, seen),
        f"<h2>Why this order</h2>{paragraphs(f'Order {report.order}: {report.order_reason}.')}{_orders(model)}",
        _gains(model),
        footer(),
    ]
    return write_text(path, document(title, "\n".join(filter(None, body)), safe_json({"diagnoses": [charts]})))


def _headline(model: IdentifiedModel) -> str:
    report = model.report
    rows = "held-out rows" if report.held_out else "the rows of its fit"
    return (
        f"A model of order {report.order} predicts {counted(len(report.outputs), 'output')} one step ahead with a fit "
        f"of {_percent(float(report.checked.fit.min()))} or better on {rows}."
    )


def _facts(model: IdentifiedModel) -> str:
    report, plant = model.report, model.plant
    rows = [
        ("Method", report.method),
        ("Rows of the fit", f"{report.samples:,}, step {length(report.dt)}"),
        ("Past rows in a state", str(report.past)),
        ("Inputs", some(plant.inputs, 20) or "none"),
        ("Outputs", some(plant.outputs, 20)),
        ("Poles", some([format_pole(one) for one in report.poles], 12) or "none"),
    ]
    return html_table(["Property", ""], [[escape(key), escape(value)] for key, value in rows])


def _fit(model: IdentifiedModel) -> str:
    report, facts = model.report, model.report.checked
    rows = []
    for i, name in enumerate(report.outputs):
        simulated = "–" if facts.simulated_fit is None else _percent(facts.simulated_fit[i])
        coloured = "coloured" if name in report.coloured else "white enough"
        rows.append(
            [
                escape(name),
                escape(_unit(model, name)) or "–",
                _num(_percent(facts.fit[i])),
                _num(simulated),
                _num(number(float(facts.error[i]))),
                _num(f"{facts.autocorrelation[i]:.2f}"),
                coloured,
            ]
        )
    header = ["Output", "Unit", "Fit one step ahead", "Fit from inputs alone", "Error (rms)", "Largest correlation", ""]
    where = f"{facts.rows:,} rows that were held out" if report.held_out else f"the {facts.rows:,} rows of the fit"
    text = (
        f"On {where}. The fit is 1 less the root mean square of the error over the standard deviation of the output: "
        "100 % is a perfect prediction, 0 % is no better than the mean."
    )
    if report.no_simulation:
        text += f" There is no fit from inputs alone: {report.no_simulation}."
    return html_table(header, rows) + f'<p class="muted">{escape(text)}</p>'


def _charts(model: IdentifiedModel, drawn: Prediction) -> dict[str, Any]:
    """Return the data for the page's script: measured and predicted outputs."""
    time = np.asarray(model.report.dt * np.arange(len(drawn.measured)), dtype=np.float64)
    bins = choose_bins(len(time), MAX_POINTS)
    missing = np.asarray(np.isnan(drawn.measured).any(axis=1))
    undecided = np.asarray(np.isnan(drawn.predicted).any(axis=1)) & ~missing
    charts = [
        {
            "kind": "signal",
            "label": visible(name),
            "unit": visible(_unit(model, name)),
            "y": [rounded(bins.extremes(drawn.measured[:, i])), rounded(bins.extremes(drawn.predicted[:, i]))],
            "names": ["measured", "predicted"],
        }
        for i, name in enumerate(model.plant.outputs)
    ]
    return over_time(time, bins, np.zeros((0, 2), dtype=np.int64), missing, undecided) | {"charts": charts}


def _curves(model: IdentifiedModel, drawn: Prediction, charts: dict[str, Any]) -> str:
    """Return the places of the charts."""
    figures = [
        f'<figure class="chart" data-chart="{k}"><figcaption>{escape(name)}</figcaption>'
        f'<div class="plot" role="img" aria-label="{escape(name)} over time"></div></figure>'
        for k, name in enumerate(model.plant.outputs)
    ]
    text = (
        f"{drawn.source}, {len(drawn.measured):,} rows; time counts from the first. Each prediction uses all rows "
        "before it. Grey stretches have none: a value is missing, or the state is still being estimated."
    )
    if charts["binned"] > 1:
        text += f" Drawn as the smallest and the largest value of every {charts['binned']} rows."
    more = figures[SHOWN_OUTPUTS:]
    behind = f"<details><summary>{len(more)} more outputs</summary>{''.join(more)}</details>" if more else ""
    return (
        f'<h2>Measured and predicted</h2><p class="muted">{escape(text)}</p><div class="charts" data-diagnosis="0">'
        '<p class="screen"><button class="all" type="button">Show all</button> '
        '<span class="muted hover">Drag over a chart to zoom; the arrow keys move the cursor.</span></p>'
        f"{''.join(figures[:SHOWN_OUTPUTS])}{behind}</div>"
    )


def autocorrelation(errors: list[NDArray[np.float64]], lags: int) -> tuple[NDArray[np.float64], NDArray[np.int_]]:
    """Return the autocorrelation of errors at lags from 1 on, shape (lags, outputs), and the numbers of pairs.

    Pairs with a missing value are left out, and none is formed across two recordings.
    """
    whole = np.concatenate(errors)
    fine = np.isfinite(whole).all(axis=1)
    mean = whole[fine].mean(axis=0) if fine.any() else np.zeros(whole.shape[1])
    power = ((whole[fine] - mean) ** 2).mean(axis=0) if fine.any() else np.ones(whole.shape[1])
    products, pairs = np.zeros((lags, whole.shape[1])), np.zeros(lags, dtype=int)
    for one in errors:
        centred = one - mean
        for lag in range(1, min(lags, len(one) - 1) + 1):
            both = centred[lag:] * centred[:-lag]
            both = both[np.isfinite(both).all(axis=1)]
            products[lag - 1] += both.sum(axis=0)
            pairs[lag - 1] += len(both)
    return products / np.maximum(pairs, 1)[:, None] / np.where(power > 0, power, 1.0), pairs


def _correlations(model: IdentifiedModel, seen: tuple[Prediction, ...]) -> str:
    own, pairs = autocorrelation([one.error for one in seen], LAGS)
    kept = int(np.count_nonzero(pairs))
    if not kept:
        return ""
    bound = float(_BOUND / np.sqrt(pairs[:kept].min()))
    pictures = [
        stems(
            range(1, kept + 1),
            own[:kept, i].tolist(),
            title=name,
            x_label=f"lag [rows of {length(model.report.dt)}]",
            y_label="autocorrelation [–]",
            bound=bound,
        )
        for i, name in enumerate(model.plant.outputs)
    ]
    text = (
        f"Autocorrelation of the errors at lags of 1 to {kept} rows. Of white errors, one bar in twenty leaves the "
        "band. If many do, the model misses dynamics of that output, and its residual is not white either."
    )
    first, more = pictures[:SHOWN_OUTPUTS], pictures[SHOWN_OUTPUTS:]
    behind = f'<details><summary>{len(more)} more outputs</summary><div class="pair">{"".join(more)}</div></details>'
    return (
        f'<h2>Prediction errors in time</h2><p class="muted">{escape(text)}</p><div class="pair">{"".join(first)}</div>'
        f"{behind if more else ''}"
    )


def _orders(model: IdentifiedModel) -> str:
    """Return singular values, criterion and held-out error by order, as pictures and as a table."""
    report = model.report
    singular = report.singular_values[: max(report.orders[-1], 1)]
    pictures = [
        stems(
            range(1, len(singular) + 1),
            singular.tolist(),
            title="Singular value of each state",
            x_label="state",
            y_label="singular value [–]",
            mark=report.order,
            log=True,
        ),
        stems(
            report.orders,
            report.criterion.tolist(),
            title="Information criterion above its smallest",
            x_label="order",
            y_label="criterion [–]",
            mark=report.order,
        ),
        stems(
            report.orders,
            (100 * report.held_out_errors).tolist(),
            title="Error on the rows held out",
            x_label="order",
            y_label="error [% of the deviation]",
            mark=report.order,
        ),
    ]
    rows = [
        [
            _num(str(order)),
            _num(number(float(report.singular_values[order - 1])) if 0 < order <= len(report.singular_values) else "–"),
            _num(number(float(report.criterion[k]))),
            _num(_percent(report.held_out_errors[k])),
            '<span class="tag">chosen</span>' if order == report.order else "",
        ]
        for k, order in enumerate(report.orders)
    ]
    table = html_table(["Order", "Singular value", "Criterion", "Error held out", ""], rows)
    return f'<div class="pair">{"".join(pictures)}</div><details><summary>In numbers</summary>{table}</details>'


def _gains(model: IdentifiedModel) -> str:
    report = model.report
    if report.steady_gain is None:
        return ""
    rows = [
        [escape(output), *(_num(report.steady_gain.text(i, j)) for j in range(len(report.inputs)))]
        for i, output in enumerate(report.outputs)
    ]
    units = [f"{name} [{_unit(model, name)}]" if _unit(model, name) else name for name in report.inputs]
    text = "The final effect of a constant input, in units of the output per unit of the input, with standard errors."
    header = ["Output", *(escape(f"per {name}") for name in units)]
    return f'<h2>Steady gains</h2><p class="muted">{text}</p>{html_table(header, rows)}'


def _unit(model: IdentifiedModel, name: str) -> str:
    return str(model.plant.units.get(name, ""))


def _num(text: str) -> str:
    return f'<td class="num">{escape(text)}</td>'


def _percent(value: float) -> str:
    return "–" if np.isnan(value) else f"{100 * value:.3g} %"
