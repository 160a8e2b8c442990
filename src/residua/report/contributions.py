"""Contributions of residuals to the statistic of an alarm, and whether they left their own bands."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from residua.report.tables import html_table
from residua.report.text import escape
from residua.words import percent

if TYPE_CHECKING:
    from residua.monitor.diagnosis import Diagnosis

#: Residuals whose shares are listed at once.
SHOWN_SHARES = 10


def averaged_residuals(diagnosis: Diagnosis) -> NDArray[np.float64]:
    """Return the residuals averaged over the window of the test; NaN without a decision."""
    out = np.where(diagnosis.decided[:, None], diagnosis.residuals, np.nan)
    n, window = len(out), diagnosis.test.averaged
    if window <= 1 or not n:
        return out
    rows = np.flatnonzero(np.isfinite(out).all(axis=1))
    total = np.vstack([np.zeros(out.shape[1]), np.cumsum(out[rows] - diagnosis.test.center, axis=0)])
    start = np.maximum(np.arange(len(rows)) + 1 - window, 0)
    out[rows] = diagnosis.test.center + (total[1:] - total[start]) / window
    return out


def shares_of_statistic(diagnosis: Diagnosis) -> NDArray[np.float64] | None:
    """Return the fraction of the squared statistic that each residual carries over the main alarm; they add to one.

    Whitened residuals are turned to lie as near as can be to the axes of the residuals (the symmetric square root of
    the inverse covariance), so that each of them belongs to one. ``None`` without an alarm, and where the statistic is
    not a norm of all residuals: of a bank by code, and of matched filters.
    """
    main = diagnosis.main_alarm
    if main is None or diagnosis.naming.codes is not None or diagnosis.match is not None:
        return None
    rows = averaged_residuals(diagnosis)[main.start : main.stop]
    rows = rows[np.isfinite(rows).all(axis=1)]
    if not len(rows):
        return None
    U, s, _ = np.linalg.svd(diagnosis.test.whitening)
    root = (U * s) @ U.T
    center = np.zeros(rows.shape[1]) if diagnosis.test.horizon else diagnosis.test.center
    squares = np.mean(((rows - center) @ root) ** 2, axis=0)
    total = float(squares.sum())
    return squares / total if total > 0 else None


def inside_band(diagnosis: Diagnosis, start: int, stop: int) -> NDArray[np.float64]:
    """Return for each residual the fraction of judged samples of a stretch inside its band; NaN for none."""
    rows = averaged_residuals(diagnosis)[start:stop]
    rows = rows[np.isfinite(rows).all(axis=1)]
    if not len(rows):
        return np.full(diagnosis.residuals.shape[1], np.nan)
    return np.mean(np.abs(rows - diagnosis.test.center) <= diagnosis.test.band, axis=0)


def contribution_html(diagnosis: Diagnosis) -> str:
    """Return the residuals that carry the statistic of the main alarm, and explain one inside its band."""
    shares = shares_of_statistic(diagnosis)
    main = diagnosis.main_alarm
    if shares is None or main is None or len(shares) < 2:
        return ""
    inside = inside_band(diagnosis, main.start, main.stop)
    order = np.argsort(-shares, kind="stable").tolist()
    rows = []
    for i in order[:SHOWN_SHARES]:
        bar = f'<td class="bar"><span style="--w:{100 * shares[i]:.1f}%"></span></td>'
        share = "–" if np.isnan(inside[i]) else percent(round(1000 * (1 - float(inside[i]))), 1000)
        name = f'<td class="name">{escape(diagnosis.generator.residuals[i])}</td>'
        rows.append([name, bar, f'<td class="num">{100 * shares[i]:.1f} %</td>', f'<td class="num">{share}</td>'])
    rest = order[SHOWN_SHARES:]
    if rest:
        total = 100 * float(shares[rest].sum())
        rows.append([f"{len(rest)} more residuals", "", f'<td class="num">{total:.1f} %</td>', ""])
    header = ["Residual", "", "Share of the squared statistic", "Alarm samples outside its normal range"]
    return (
        "<h3>Which residuals carry the alarm</h3>"
        f"{html_table(header, rows, caption='Share of the statistic by residual, mean over the main alarm')}"
        f"{_inside_text(diagnosis, order[0], float(shares[order[0]]), float(inside[order[0]]))}"
    )


def channels_by_reconstruction(diagnosis: Diagnosis) -> list[tuple[str, float]]:
    """Return the channels whose reconstruction removes most of the residual, with the share, over the main alarm.

    The mean of the squared scores: the part of the squared norm of the residual, averaged over the window of the
    isolation, that the best change of that channel alone takes away. The shares do not add to one. Empty without an
    alarm, and where faults are not those of channels alone: of a plant with states or inputs.

    References
    ----------
    Dunia and Qin (1998), AIChE Journal 44(8), 1813-1831.
    """
    main, plant = diagnosis.main_alarm, diagnosis.generator.plant
    if main is None or plant.n_states or plant.inputs or not diagnosis.naming.signatures:
        return []
    channels = len(diagnosis.groups) - len(diagnosis.naming.learnt_faults)  # learnt faults are not channels
    rows = diagnosis.scores[main.start : main.stop, :channels]
    rows = rows[np.isfinite(rows).all(axis=1)]
    if not len(rows):
        return []
    shares = np.mean(rows**2, axis=0)
    order = np.argsort(-shares, kind="stable").tolist()
    return [(diagnosis.group_names[g], float(shares[g])) for g in order]


def reconstruction_html(diagnosis: Diagnosis) -> str:
    """Return the channels by their contributions by reconstruction."""
    channels = channels_by_reconstruction(diagnosis)
    if len(channels) < 2:
        return ""
    rows = [
        [
            f'<td class="name">{escape(name)}</td>',
            f'<td class="bar"><span style="--w:{100 * share:.1f}%"></span></td>',
            f'<td class="num">{100 * share:.1f} %</td>',
        ]
        for name, share in channels[:SHOWN_SHARES]
    ]
    caption = "Share of the squared residual that the best reconstruction of one channel removes, mean over the alarm"
    return f"<h3>Which channel explains the alarm</h3>{html_table(['Channel', '', 'Share'], rows, caption=caption)}"


def _inside_text(diagnosis: Diagnosis, i: int, share: float, inside: float) -> str:
    """Explain how a residual can carry an alarm from inside its band, if it does."""
    if not inside >= 0.5:
        return ""
    how = "the whole" if inside == 1 else f"{percent(round(1000 * inside), 1000)} of the"
    name = escape(diagnosis.generator.residuals[i])
    return (
        f"<p><b>{name} carries {100 * share:.0f} % of the statistic although it stayed inside its normal range for "
        f"{how} alarm.</b> That range is for this residual alone. The test judges all residuals together, by how they "
        "move together without a fault: several small deviations at once, or one that the others do not follow, can be "
        "as unlikely as a large one.</p>"
    )
