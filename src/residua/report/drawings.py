"""Small drawings as SVG: values by whole numbers as stems, and curves, points with intervals and steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.report.text import escape
from residua.words import number

_WIDTH, _HEIGHT = 340, 210
#: Room for labels on the left, above, on the right and below.
_LEFT, _TOP, _RIGHT, _BOTTOM = 62, 14, 8, 38
_ACROSS, _UP = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
#: Ticks of a vertical axis, and labels of a horizontal one, about.
_TICKS, _LABELS = 4, 8
#: A logarithmic axis reaches down so many decades from its top.
_DECADES = 8
#: Colours of the page.
COLOURS = 8


def stems(
    x: Sequence[int],
    y: Sequence[float],
    *,
    title: str,
    x_label: str,
    y_label: str,
    mark: int | None = None,
    bound: float | None = None,
    log: bool = False,
) -> str:
    """Return one value for each whole number as a stem plot, as SVG.

    Parameters
    ----------
    x : sequence of int
    y : sequence of float
        Those that are not finite are left out; on a logarithmic axis those that are not positive too.
    title, x_label, y_label : str
    mark : int, optional
        The one that is drawn in another colour.
    bound : float, optional
        Within plus and minus this is a band.
    log : bool
        Whether the vertical axis is logarithmic.

    Returns
    -------
    str
    """
    values = np.array(y, dtype=float)
    fine = np.isfinite(values) & ((values > 0) | (not log))
    if not fine.any():
        return ""
    low, high, ticks = _logarithmic(values[fine]) if log else _linear(values[fine], bound)
    across = {k: _LEFT + _ACROSS * (i + 0.5) / len(x) for i, k in enumerate(x)}

    def up(value: float) -> float:
        part = (np.log10(max(value, 10**low)) if log else value) - low
        return float(_TOP + _UP * (1 - part / (high - low)))

    parts = [_tick(up(t), f"{t:.0e}".replace("e+0", "e").replace("e-0", "e-") if log else number(t)) for t in ticks]
    if bound is not None:
        top, bottom = up(bound), up(-bound)
        parts.append(
            f'<rect x="{_LEFT}" y="{top:.1f}" width="{_ACROSS}" height="{bottom - top:.1f}" style="fill:var(--band)"/>'
        )
    base = up(10**low) if log else up(0.0)
    every = max(1, -(-len(x) // _LABELS))
    for i, (k, value) in enumerate(zip(x, values, strict=True)):
        colour = "var(--c1)" if k == mark else "var(--c0)"
        if i % every == 0:
            parts.append(_text(across[k], _HEIGHT - _BOTTOM + 15, str(k), "middle"))
        if fine[i]:
            parts.append(
                f'<g style="stroke:{colour};fill:{colour}"><line x1="{across[k]:.1f}" x2="{across[k]:.1f}" '
                f'y1="{base:.1f}" y2="{up(value):.1f}" stroke-width="2"/>'
                f'<circle cx="{across[k]:.1f}" cy="{up(value):.1f}" r="3.2"/>'
                f"<title>{escape(x_label)} {k}: {escape(number(float(value)))}</title></g>"
            )
    return _framed(parts, title, x_label, y_label)


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
    low, high, ticks = _linear(tall if top is None else np.array([0.0, top]), None)

    def place(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        with np.errstate(divide="ignore", invalid="ignore"):
            at = (np.log10(x) if log else x) - left
        across = _LEFT + _ACROSS * np.clip(np.nan_to_num(at / (right - left), nan=0.0, posinf=1.0, neginf=0.0), 0, 1)
        return across, _TOP + _UP * (1 - np.clip((y - low) / (high - low), 0, 1))

    parts = [_tick(float(_TOP + _UP * (1 - (t - low) / (high - low))), number(t)) for t in ticks]
    for mark in marks:
        (x,), _ = place(np.array([mark]), np.array([low]))
        parts.append(_text(float(x), _HEIGHT - _BOTTOM + 15, number(mark), "middle"))
    colour = 0
    for line in lines:
        parts.append(_drawn(line, place, "var(--muted)" if not line.name else f"var(--c{colour % COLOURS})"))
        colour += bool(line.name)
    return _framed(parts, title, x_label, y_label)


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
        low, high, ticks = _linear(x, None)
        return low, high, ticks
    low, high = float(np.log10(x.min())), float(np.log10(x.max()))
    if high <= low:
        low, high = low - 0.5, high + 0.5
    marks = 10.0 ** np.linspace(low, high, 4)
    return low, high, [float(f"{mark:.2g}") for mark in marks]


def _framed(parts: Sequence[str], title: str, x_label: str, y_label: str) -> str:
    """Return the parts of a drawing as a figure, with the names of its axes."""
    below = _text(_LEFT + _ACROSS / 2, _HEIGHT - 6, x_label, "middle")
    return (
        f'<figure style="margin:0 0 10px"><figcaption>{escape(title)}</figcaption>'
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" height="{_HEIGHT}" style="max-width:100%" '
        f'role="img" aria-label="{escape(title)}">{"".join(parts)}{below}'
        f'<text transform="translate(12 {_TOP + _UP / 2:.0f}) rotate(-90)" text-anchor="middle" '
        f'style="fill:var(--muted);font-size:12px">{escape(y_label)}</text></svg></figure>'
    )


def _tick(at: float, label: str) -> str:
    """Return a line across a picture at a value of its upright axis, with that value."""
    line = f'<line x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{at:.1f}" y2="{at:.1f}" style="stroke:var(--grid)"/>'
    return line + _text(_LEFT - 6, at + 4, label, "end")


def _text(x: float, y: float, text: str, anchor: str) -> str:
    """Return the text of an axis."""
    style = "fill:var(--muted);font-size:12px"
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" style="{style}">{escape(text)}</text>'


def _linear(values: np.ndarray, bound: float | None) -> tuple[float, float, list[float]]:
    """Return the ends of an axis with zero and the bound on it, and its ticks."""
    low = min(0.0, float(values.min()), -(bound or 0.0))
    high = max(0.0, float(values.max()), bound or 0.0)
    high = high if high > low else low + 1.0
    step = 10.0 ** np.floor(np.log10((high - low) / _TICKS))
    step *= next(k for k in (1, 2, 5, 10) if (high - low) / (k * step) <= _TICKS + 1)
    first, last = int(np.floor(round(low / step, 6))), int(np.ceil(round(high / step, 6)))
    low, high = first * step, last * step
    return low, high, [float(step * k) for k in range(first, last + 1)]


def _logarithmic(values: np.ndarray) -> tuple[float, float, list[float]]:
    """Return the ends of a logarithmic axis, as exponents, and its ticks."""
    top = float(values.max())
    low, high = int(np.floor(np.log10(max(values.min(), top / 10.0**_DECADES)))), int(np.ceil(np.log10(top)))
    high = max(high, low + 1)
    every = -(-(high - low) // _TICKS)
    return float(low), float(high), [10.0**k for k in range(low, high + 1, every)]


__all__ = ["COLOURS", "Curve", "curves", "stems"]
