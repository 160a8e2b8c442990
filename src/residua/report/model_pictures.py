"""Small pictures of an identified model, as SVG: values by order, the correlation of errors by lag."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from residua.report.text import escape
from residua.words import number

_WIDTH, _HEIGHT = 340, 210
#: Room for labels on the left, above, on the right and below.
_LEFT, _TOP, _RIGHT, _BOTTOM = 62, 14, 8, 38
#: Ticks of a vertical axis, and labels of a horizontal one, about.
_TICKS, _LABELS = 4, 8
#: A logarithmic axis reaches down so many decades from its top.
_DECADES = 8


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
    low, high, ticks = _logarithmic(values[fine]) if log else linear_axis(values[fine], bound)
    width, height = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
    across = {k: _LEFT + width * (i + 0.5) / len(x) for i, k in enumerate(x)}

    def up(value: float) -> float:
        part = (np.log10(max(value, 10**low)) if log else value) - low
        return float(_TOP + height * (1 - part / (high - low)))

    parts = [tick(up(t), f"{t:.0e}".replace("e+0", "e").replace("e-0", "e-") if log else number(t)) for t in ticks]
    if bound is not None:
        top, bottom = up(bound), up(-bound)
        parts.append(
            f'<rect x="{_LEFT}" y="{top:.1f}" width="{width}" height="{bottom - top:.1f}" style="fill:var(--band)"/>'
        )
    base = up(10**low) if log else up(0.0)
    every = max(1, -(-len(x) // _LABELS))
    for i, (k, value) in enumerate(zip(x, values, strict=True)):
        colour = "var(--c1)" if k == mark else "var(--c0)"
        if i % every == 0:
            parts.append(text_at(across[k], _HEIGHT - _BOTTOM + 15, str(k), "middle"))
        if fine[i]:
            parts.append(
                f'<g style="stroke:{colour};fill:{colour}"><line x1="{across[k]:.1f}" x2="{across[k]:.1f}" '
                f'y1="{base:.1f}" y2="{up(value):.1f}" stroke-width="2"/>'
                f'<circle cx="{across[k]:.1f}" cy="{up(value):.1f}" r="3.2"/>'
                f"<title>{escape(x_label)} {k}: {escape(number(float(value)))}</title></g>"
            )
    parts.append(text_at(_LEFT + width / 2, _HEIGHT - 6, escape(x_label), "middle"))
    parts.append(
        f'<text transform="translate(12 {_TOP + height / 2:.0f}) rotate(-90)" text-anchor="middle" '
        f'style="fill:var(--muted);font-size:12px">{escape(y_label)}</text>'
    )
    return (
        f'<figure style="margin:0 0 10px"><figcaption>{escape(title)}</figcaption>'
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" height="{_HEIGHT}" style="max-width:100%" '
        f'role="img" aria-label="{escape(title)}">'
        f"{''.join(parts)}</svg></figure>"
    )


def tick(at: float, label: str) -> str:
    """Return a line across a picture at a value of its upright axis, with that value."""
    line = f'<line x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{at:.1f}" y2="{at:.1f}" style="stroke:var(--grid)"/>'
    return line + text_at(_LEFT - 6, at + 4, escape(label), "end")


def text_at(x: float, y: float, text: str, anchor: str) -> str:
    """Return the text of an axis."""
    style = "fill:var(--muted);font-size:12px"
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" style="{style}">{text}</text>'


def linear_axis(values: np.ndarray, bound: float | None) -> tuple[float, float, list[float]]:
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
