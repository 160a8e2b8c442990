"""Plots with matplotlib. Only a caller who has imported pyplot gets figures that pyplot knows."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from residua.arrays import runs
from residua.errors import missing_extra
from residua.report.charts import (
    LOG_FROM,
    PEAK_FLOOR,
    began_spans,
    by_interest,
    estimated_fault,
    judged_range,
    norm_unit,
    onsets,
    own_alarms,
    residual_unit,
    shows_scores,
)
from residua.report.choosing import shown_groups
from residua.report.codes import member_order
from residua.report.decimate import choose_bins
from residua.report.signatures import Signatures, generator_signatures
from residua.report.text import with_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from residua.design.core.generator import ResidualGenerator
    from residua.monitor.diagnosis import Diagnosis

_COLOURS = ("#0b5cad", "#c4501b", "#00785a", "#8b3fa0", "#946200", "#007a94", "#b0235f", "#4b5560")
_STYLES = ("-", "--", ":", "-.")
_ALARM, _MISSING, _BAND, _BEGAN = "#c8281e", "#5a6473", "#00805f", "#d68c00"
#: Residuals that are plotted at most (those furthest out of their band), and points per line.
_MAX_RESIDUALS = 8
_MAX_POINTS = 4000
#: Characters of a name that fit along the y axis of a residual's panel.
_AXIS_CHARACTERS = 16


def plot_diagnosis(diagnosis: Diagnosis, ax: Axes | None = None, *, figure: Figure | None = None) -> Any:
    """Plot residuals with their bands, the statistic with its threshold, and the candidates' scores.

    Alarms are shaded red, missing values grey. Long recordings are drawn as the smallest and largest value
    of each bin of samples. At most eight residuals are drawn: those that went furthest out of their bands. Of a bank
    the statistics of its members stand in their place, and estimates of faults.

    Parameters
    ----------
    diagnosis : Diagnosis
    ax : matplotlib Axes, optional
        Draw only the statistic, its threshold and the alarms, on these axes.
    figure : matplotlib Figure, optional
        Draw into this figure; a new one when omitted, which pyplot knows if it has been imported.

    Returns
    -------
    matplotlib Figure, or the Axes of the call

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    if ax is not None:
        _statistic(diagnosis, ax, loc="upper left")
        ax.set_xlabel("time [s]")
        return ax
    members = member_order(diagnosis, _MAX_RESIDUALS)[:_MAX_RESIDUALS]
    shown = [i for i in by_interest(diagnosis) if not members or _is_estimate(diagnosis, i)][:_MAX_RESIDUALS]
    with_scores = shows_scores(diagnosis)
    heights = [1.0] * (len(shown) + len(members)) + [1.4] + [1.6] * with_scores
    figure = figure or _new_figure(8.0, 1.0 + 1.15 * sum(heights))
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    for i, panel in zip(shown, axes, strict=False):
        _residual(diagnosis, i, panel)
    for m, panel in zip(members, axes[len(shown) :], strict=False):
        _member(diagnosis, m, panel)
    _statistic(diagnosis, axes[len(shown) + len(members)], loc="lower left", bbox_to_anchor=(0.0, 1.0))
    if with_scores:
        _scores(diagnosis, axes[-1])
    axes[-1].set_xlabel("time [s]")
    title = diagnosis.generator.plant.name
    figure.suptitle(_plain(f"{title}: {diagnosis.recording.source}" if diagnosis.recording.source else title))
    return figure


def plot_structure(generator: ResidualGenerator, ax: Axes | None = None) -> Axes:
    """Plot the responses to faults: a dark square where a residual, or a member of a bank, answers to a fault.

    Parameters
    ----------
    generator : ResidualGenerator
    ax : matplotlib Axes, optional
        A new figure's when omitted (``ax.figure``).

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    faults, residuals, fires, what = generator.faults, generator.residuals, generator.structure.T, "residual"
    if generator.codes is not None:
        residuals, fires, what = tuple(m.name for m in generator.members), generator.codes.T, "member"
    if ax is None:
        ax = _new_figure(2.5 + 0.4 * len(residuals), 1.6 + 0.3 * len(faults)).subplots()
    ax.imshow(fires, cmap="Blues", vmin=0, vmax=1.25, aspect="auto")
    _matrix_axes(ax, residuals, faults)
    ax.set_xlabel(what)
    ax.set_ylabel("what fails")
    ax.set_title(f"Which {what}s answer to which fault")
    return ax


def plot_directions(generator: ResidualGenerator, ax: Axes | None = None) -> Axes:
    """Plot the similarity of the signatures of faults: the cosine of the smallest angle between every two.

    The cosine is the largest principal one: 1 means that two signatures share a direction. Signatures and groups
    are those of a monitor with default settings (:class:`residua.decide.Directional`), with residuals whitened
    by the covariance that the plant's noise gives them. Faults without a signature come last, without values.
    With exactly two residuals the directions themselves are drawn.

    Parameters
    ----------
    generator : ResidualGenerator
    ax : matplotlib Axes, optional
        A new figure's when omitted (``ax.figure``).

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    known = generator_signatures(generator)
    n = len(known.labels)
    labels = tuple(label.replace(" or ", " or\n") for label in known.labels)
    if ax is None:
        lines = 1 + max((label.count("\n") for label in labels), default=0)
        side = n * (0.24 + 0.18 * lines)
        ax = _new_figure(3.0 + 0.4 * lines + side, 2.2 + 0.4 * lines + side).subplots()
    if generator.n_residuals == 2:
        return _plane(known, generator.residuals, ax)
    similarity = known.similarity()
    image = ax.imshow(np.ma.masked_invalid(similarity), cmap="Blues", vmin=0, vmax=1)
    _matrix_axes(ax, labels, labels)
    for row in range(n):
        for column in range(n):
            value = similarity[row, column]
            text = f"{value:.2f}" if np.isfinite(value) else "–"
            ax.text(column, row, text, ha="center", va="center", fontsize=8, color="white" if value > 0.6 else "black")
    bar = ax.figure.colorbar(image, ax=ax, shrink=0.8)
    bar.set_label("cosine of the smallest angle [–]")
    ax.set_title("Likeness of signatures" + (", whitened" if known.whitened else ""))
    return ax


def _new_figure(width: float, height: float) -> Figure:
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise missing_extra("matplotlib", "plot") from error
    size = (min(width, 16.0), min(height, 20.0))
    pyplot = sys.modules.get("matplotlib.pyplot")
    if pyplot is not None:  # the caller works with pyplot: notebooks and show() then know the figure
        return pyplot.figure(figsize=size, layout="constrained")
    return Figure(figsize=size, layout="constrained")


def _plain(text: str) -> str:
    """Return text that matplotlib does not interpret as mathematics."""
    return text.replace("$", r"\$")


def _line(diagnosis: Diagnosis, values: np.ndarray, ax: Axes, **style: Any) -> None:
    bins = choose_bins(len(diagnosis.time), _MAX_POINTS)
    ax.plot(bins.times(diagnosis.time), bins.extremes(values), **style)


def _shade(diagnosis: Diagnosis, ax: Axes, member: int | None = None) -> None:
    """Shade alarms and missing values; only the first of each gets a name in the legend.

    With a member of a dedicated bank, its own alarms.
    """
    last = len(diagnosis.time) - 1
    stretches, begun = [(a.start, a.stop) for a in diagnosis.alarms], onsets(diagnosis)
    own = None if member is None else own_alarms(diagnosis, member)
    if member is not None and own is not None:
        stretches = own.tolist()
        begun = [p.since for a in diagnosis.alarms[:50] for p in a.present if p.member == diagnosis.members[member]]
    for pairs, colour, name in (
        (stretches, _ALARM, "alarm"),
        (runs(diagnosis.missing).tolist(), _MISSING, "values missing"),
    ):
        for k, (start, stop) in enumerate(pairs[:500]):
            left, right = diagnosis.time[min(start, last)], diagnosis.time[min(stop, last)]
            ax.axvspan(left, right, color=colour, alpha=0.16, lw=0, label=name if k == 0 else None)
    for k, (left, right) in enumerate(began_spans(diagnosis) if member is None or own is None else []):
        ax.axvspan(left, right, color=_BEGAN, alpha=0.28, lw=0, label="began (95 %)" if k == 0 else None)
    for k, onset in enumerate(begun):
        ax.axvline(onset, color=_ALARM, lw=1, ls=":", label="first over" if k == 0 else None)


def _residual(diagnosis: Diagnosis, i: int, ax: Axes) -> None:
    name = diagnosis.generator.residuals[i]
    center, band = float(diagnosis.test.center[i]), float(diagnosis.test.band[i])
    if np.isfinite(center) and np.isfinite(band):
        ax.axhspan(center - band, center + band, color=_BAND, alpha=0.16, lw=0)
    _shade(diagnosis, ax)
    _line(diagnosis, diagnosis.residuals[:, i], ax, color=_COLOURS[0], lw=0.9)
    limits = judged_range(diagnosis, i)
    if limits is not None:
        known = [v for v in (center - band, center + band) if np.isfinite(v)]
        low, high = min([limits[0], *known]), max([limits[1], *known])
        if high > low:
            ax.set_ylim(low - 0.1 * (high - low), high + 0.1 * (high - low))
    fault = estimated_fault(diagnosis, name)
    _name(ax, f"estimated {fault}" if fault else name, residual_unit(diagnosis, name))
    ax.margins(x=0)


def _name(ax: Axes, name: str, unit: str) -> None:
    """Name a panel on its y axis; above it if the name is longer than the axis, and would reach the next one."""
    if len(with_unit(name, unit)) <= _AXIS_CHARACTERS:
        ax.set_ylabel(_plain(with_unit(name, unit)))
        return
    ax.set_title(_plain(name), loc="left", fontsize="small")
    if unit:
        ax.set_ylabel(_plain(f"[{unit}]"))


def _is_estimate(diagnosis: Diagnosis, i: int) -> bool:
    return bool(estimated_fault(diagnosis, diagnosis.generator.residuals[i]))


def _member(diagnosis: Diagnosis, m: int, ax: Axes) -> None:
    """Draw the statistic of one member of a bank with its threshold."""
    _shade(diagnosis, ax, m)
    _line(diagnosis, diagnosis.parts.statistics[:, m], ax, color=_COLOURS[0], lw=0.9)
    ax.axhline(diagnosis.parts.thresholds[m], color=_ALARM, ls="--", lw=1.2)
    ax.set_title(_plain(diagnosis.members[m]), loc="left", fontsize="small")
    ax.set_ylabel(_plain(with_unit("norm", norm_unit(diagnosis, m))) if diagnosis.test.horizon else "statistic [–]")
    _scale(diagnosis, ax, diagnosis.parts.statistics, diagnosis.parts.thresholds, m)
    ax.margins(x=0)


def _statistic(diagnosis: Diagnosis, ax: Axes, **place: Any) -> None:
    _shade(diagnosis, ax)
    _line(diagnosis, diagnosis.statistic, ax, color=_COLOURS[0], lw=0.9, label="statistic")
    if np.isfinite(diagnosis.threshold):
        ax.axhline(diagnosis.threshold, color=_ALARM, ls="--", lw=1.2, label="threshold")
    norm = _plain(with_unit("norm", norm_unit(diagnosis))) if diagnosis.test.horizon else "statistic [–]"
    ax.set_ylabel("largest ratio to\nthreshold [–]" if diagnosis.members else norm)
    _scale(diagnosis, ax, diagnosis.statistic[:, None], np.array([diagnosis.threshold]), 0)
    ax.margins(x=0)
    ax.legend(fontsize="small", ncols=5, **place)


def _scale(diagnosis: Diagnosis, ax: Axes, values: np.ndarray, limits: np.ndarray, m: int) -> None:
    """Give a norm that far exceeds its threshold a logarithmic axis; all members alike."""
    ratio = values / limits
    if not diagnosis.test.horizon or not np.any(ratio > LOG_FROM):
        return
    ax.set_yscale("log")
    top = np.nanmax(np.where(np.isfinite(values[:, m]), values[:, m], np.nan), initial=limits[m])
    ax.set_ylim(PEAK_FLOOR * limits[m], 2 * top)


def _scores(diagnosis: Diagnosis, ax: Axes) -> None:
    _shade(diagnosis, ax)
    handles = []
    for k, g in enumerate(shown_groups(diagnosis)):
        before = len(ax.lines)
        style = _STYLES[k // len(_COLOURS) % len(_STYLES)]
        label = _plain(diagnosis.group_names[g])
        _line(diagnosis, diagnosis.scores[:, g], ax, color=_COLOURS[k % len(_COLOURS)], ls=style, lw=1.2, label=label)
        handles += ax.lines[before:]
    ax.set_ylim(0, 1.02)
    ax.set_ylabel("score [–]")
    ax.margins(x=0)
    ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.3), fontsize="small", ncols=4)


def _matrix_axes(ax: Axes, columns: tuple[str, ...], rows: tuple[str, ...]) -> None:
    ax.set_xticks(range(len(columns)), [_plain(c) for c in columns], rotation=45, ha="right", rotation_mode="anchor")
    ax.set_yticks(range(len(rows)), [_plain(r) for r in rows])


def _plane(known: Signatures, residuals: tuple[str, ...], ax: Axes) -> Axes:
    turns = np.linspace(0, 2 * np.pi, 181)
    ax.plot(np.cos(turns), np.sin(turns), color="0.8", lw=1)
    for k, (label, basis) in enumerate(zip(known.labels, known.bases, strict=True)):
        style = {"color": _COLOURS[k % len(_COLOURS)], "label": _plain(label), "lw": 1.8}
        if basis.shape[1] == 1:
            x, y = basis[:, 0]
            ax.plot([-x, x], [-y, y], **style)
        elif basis.shape[1] == 2:
            ax.fill(np.cos(turns), np.sin(turns), alpha=0.08, **style)
        else:  # only its name: nothing to draw
            ax.plot([], [], ls="none", label=f"{_plain(label)} (no signature)")
    ax.set_aspect("equal")
    for setter, name in zip((ax.set_xlabel, ax.set_ylabel), residuals, strict=True):
        setter(_plain(name) + (", whitened [–]" if known.whitened else ", direction [–]"))
    ax.set_title("Signature directions")
    if known.labels:
        ax.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.02, 0.5))
    return ax
