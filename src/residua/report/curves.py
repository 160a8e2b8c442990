"""Curves, points with intervals and bands in one small picture, as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.report.model_pictures import linear_axis, text_at, tick
from residua.report.text import escape
from residua.words import number

_WIDTH, _HEIGHT = 340, 210
#: Room for labels on the left, above, on the right and below, as of the other small pictures.
_LEFT, _TOP, _RIGHT, _BOTTOM = 62, 14, 8, 38
#: Colours of the page.
COLOURS = 8


@dataclass(frozen=True, eq=False)
class Curve:
    """One line of a picture.

    Attributes
    ----------
    name : str
        Shown when the pointer rests on it; empty: a reference line.
    x, y : array_like
        Values that are not finite end at the edge of the picture.
    low, high : array_like, optional
        Ends of an interval at each point, drawn as bars.
    steps : bool
        Whether the value stays up to the next point.
    points : bool
        Whether points are drawn instead of a line.
    """

    name: str
    x: ArrayLike
    y: ArrayLike
    low: ArrayLike | None = None
    high: ArrayLike | None = None
    steps: bool = False
    points: bool = False


def curves(
    lines: Sequence[Curve], *, title: str, x_label: str, y_label: str, log: bool = False, top: float | None = None
) -> str:
    """Return curves over a common axis as SVG; nothing without a value.

    Parameters
    ----------
    lines : sequence of Curve
    title, x_label, y_label : str
    log : bool
        Whether the horizontal axis is logarithmic.
    top : float, optional
        Upper end of the upright axis, which begins at zero.
    """
    whole = np.concatenate([np.asarray(line.x, dtype=float) for line in lines]) if lines else np.zeros(0)
    whole = whole[np.isfinite(whole) & ((whole > 0) | (not log))]
    heights = [np.asarray(part, dtype=float) for one in lines for part in (one.y, one.high) if part is not None]
    tall = np.concatenate(heights) if heights else np.zeros(0)
    tall = tall[np.isfinite(tall)]
    if not whole.size or not tall.size:
        return ""
    left, right, marks = _across(whole, log)
    low, high, ticks = linear_axis(tall if top is None else np.array([0.0, top]), None)
    width, height = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM

    def place(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        with np.errstate(divide="ignore", invalid="ignore"):
            at = (np.log10(x) if log else x) - left
        across = _LEFT + width * np.clip(np.nan_to_num(at / (right - left), nan=0.0, posinf=1.0, neginf=0.0), 0, 1)
        return across, _TOP + height * (1 - np.clip((y - low) / (high - low), 0, 1))

    parts = [tick(float(_TOP + height * (1 - (t - low) / (high - low))), number(t)) for t in ticks]
    for mark in marks:
        (x,), _ = place(np.array([mark]), np.array([low]))
        parts.append(text_at(float(x), _HEIGHT - _BOTTOM + 15, number(mark), "middle"))
    colour = 0
    for line in lines:
        parts.append(_drawn(line, place, "var(--muted)" if not line.name else f"var(--c{colour % COLOURS})"))
        colour += bool(line.name)
    parts.append(text_at(_LEFT + width / 2, _HEIGHT - 6, escape(x_label), "middle"))
    parts.append(
        f'<text transform="translate(12 {_TOP + height / 2:.0f}) rotate(-90)" text-anchor="middle" '
        f'style="fill:var(--muted);font-size:12px">{escape(y_label)}</text>'
    )
    return (
        f'<figure style="margin:0 0 10px"><figcaption>{escape(title)}</figcaption>'
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" height="{_HEIGHT}" style="max-width:100%" '
        f'role="img" aria-label="{escape(title)}">{"".join(parts)}</svg></figure>'
    )


def _drawn(line: Curve, place, colour: str) -> str:
    """Return one line, or its points, with their intervals."""
    x, y = np.asarray(line.x, dtype=float), np.asarray(line.y, dtype=float)
    fine = np.isfinite(y) & ~np.isnan(x)
    across, up = place(x[fine], y[fine])
    name = f"<title>{escape(line.name)}</title>" if line.name else ""
    if line.points:
        dots = [f'<circle cx="{a:.1f}" cy="{b:.1f}" r="3.2"/>' for a, b in zip(across, up, strict=True)]
        if line.low is not None and line.high is not None:
            ends = [place(x[fine], np.asarray(one, dtype=float)[fine])[1] for one in (line.low, line.high)]
            dots += [
                f'<line x1="{a:.1f}" x2="{a:.1f}" y1="{b:.1f}" y2="{c:.1f}"/>'
                for a, b, c in zip(across, *ends, strict=True)
            ]
        return f'<g style="stroke:{colour};fill:{colour}">{name}{"".join(dots)}</g>'
    if line.steps and len(across):
        across, up = np.repeat(across, 2)[1:], np.repeat(up, 2)[:-1]
    path = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across, up, strict=True))
    dash = "" if line.name else ' stroke-dasharray="4 3"'
    return f'<polyline points="{path}" fill="none" style="stroke:{colour}" stroke-width="1.6"{dash}>{name}</polyline>'


def _across(x: NDArray[np.float64], log: bool) -> tuple[float, float, list[float]]:
    """Return the ends of the horizontal axis, as exponents of a logarithmic one, and the values with a label."""
    if not log:
        low, high, ticks = linear_axis(x, None)
        return low, high, ticks
    low, high = float(np.log10(x.min())), float(np.log10(x.max()))
    if high <= low:
        low, high = low - 0.5, high + 0.5
    marks = 10.0 ** np.linspace(low, high, 4)
    return low, high, [float(f"{mark:.2g}") for mark in marks]


__all__ = ["Curve", "curves"]
