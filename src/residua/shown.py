"""The display of results in a notebook: a headline, a table and a chart, in one form for all of them."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.visible import shortened, visible
from residua.words import number

#: Characters of a ``repr``, and rows of a table, at most.
_MOST, _ROWS = 200, 20
#: Rows and columns of a grid at most, and characters of their names.
_GRID, _NAME = 60, 24
#: Points that a line is drawn with, about: the smallest and the largest value of each bin.
_BINS = 400
#: Width and height of a chart, and the room for the labels of its axes, in pixels.
_WIDTH, _HEIGHT, _LEFT, _BOTTOM = 640, 170, 64, 18
#: From so many times the threshold on the axis is logarithmic, and reaches down to that part of the threshold.
_LOGARITHMIC, _FLOOR = 10.0, 0.1
#: The look of a cell but for its side.
_CELL = "padding:.15em .8em .15em 0;vertical-align:top;text-align:"
#: Seen on white and on black; all else has the colour of the notebook's text.
_BLUE, _RED = "#3d85c6", "#d9534f"


class Shown:
    """Base of results with a one-line ``repr`` and a display in notebooks.

    A class that prints as several lines needs no more: the first one is the headline. A dataclass that has this base is
    declared with ``repr=False``.
    """

    def _headline(self) -> str:
        """Return the result in one line."""
        return str(self).partition("\n")[0]

    def _parts(self) -> Iterable[str]:
        """Return the content below the headline, as HTML."""
        return [printed(str(self).partition("\n")[2])]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({shortened(visible(self._headline()), _MOST)})"

    def _repr_html_(self) -> str:
        """Return the display in a notebook."""
        head = f"<p><b>{type(self).__name__}</b> {escaped(self._headline())}</p>"
        return f'<div style="max-width:100%;overflow-x:auto">{head}{"".join(self._parts())}</div>'


@dataclass(frozen=True)
class Bar:
    """A cell of a table with a bar before its text.

    Attributes
    ----------
    share : float
        Length of the bar, 0 to 1.
    text : str
    """

    share: float
    text: str

    def __str__(self) -> str:
        width = 80 * min(max(self.share, 0.0), 1.0) if math.isfinite(self.share) else 0.0
        return (
            '<svg width="80" height="9" aria-hidden="true"><rect width="80" height="9" fill="currentColor" '
            f'opacity=".15"/><rect width="{width:.1f}" height="9" fill="{_BLUE}"/></svg> {escaped(self.text)}'
        )


def escaped(value: object) -> str:
    """Return a text or a number as HTML."""
    if isinstance(value, float):
        return number(value)
    return html.escape(visible(str(value)))


def printed(text: str) -> str:
    """Return lines of text as printed; nothing without any."""
    return f"<pre>{escaped(text)}</pre>" if text.strip() else ""


def notes(texts: Iterable[str]) -> str:
    """Return sentences as a list; nothing without any."""
    items = "".join(f"<li>{escaped(text)}</li>" for text in texts)
    return f"<ul>{items}</ul>" if items else ""


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table, cut after some rows; cells are texts, numbers or a :class:`Bar`."""
    whole = list(rows)
    head = "".join(f'<th style="{_CELL}left">{escaped(name)}</th>' for name in header)
    body = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in whole[:_ROWS])
    more = f"<p>and {len(whole) - _ROWS} more rows</p>" if len(whole) > _ROWS else ""
    content = f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody>"
    return f'<table style="font-size:inherit;border-collapse:collapse">{content}</table>{more}' if whole else ""


def _cell(value: object) -> str:
    side = "right" if isinstance(value, (int, float)) and not isinstance(value, bool) else "left"
    return f'<td style="{_CELL}{side}">{value if isinstance(value, Bar) else escaped(value)}</td>'


def line_chart(
    x: ArrayLike,
    y: ArrayLike,
    *,
    label: str,
    limit: float | None = None,
    spans: Iterable[tuple[float, float]] = (),
    ends: tuple[str, str] | None = None,
) -> str:
    """Return a line over time as SVG; nothing without a value.

    Parameters
    ----------
    x, y : array_like, shape (n,)
        Times in order; a gap is drawn where ``y`` is not finite.
    label : str
    limit : float, optional
        Drawn as a dashed line; far above it the axis is logarithmic.
    spans : iterable of (float, float)
        Intervals of ``x`` that are marked.
    ends : (str, str), optional
        The first and the last time in words; as numbers when omitted.
    """
    times, values = _binned(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
    seen = values[np.isfinite(values)]
    if not seen.size:
        return ""
    top, bottom = max(float(seen.max()), limit or 0.0), min(float(seen.min()), 0.0)
    is_log = limit is not None and limit > 0 and top > _LOGARITHMIC * limit
    floor = _FLOOR * (limit or 1.0)

    def height(value: NDArray[np.float64] | float) -> NDArray[np.float64]:
        part = (np.asarray(value) - bottom) / ((top - bottom) or 1.0)
        if is_log:
            part = np.log(np.maximum(value, floor) / floor) / np.log(top / floor)
        return (_HEIGHT - _BOTTOM) * (1 - part * 0.94)

    first, last = float(times[0]), float(times[-1])

    def across(value: NDArray[np.float64] | float) -> NDArray[np.float64]:
        return _LEFT + (_WIDTH - _LEFT) * np.clip((np.asarray(value) - first) / ((last - first) or 1.0), 0, 1)

    parts = []
    for start, stop in spans:
        left, right = float(across(start)), float(across(stop))
        wide = max(right - left, 1.5)
        parts.append(_rect(left, 0, wide, _HEIGHT - _BOTTOM, _RED, 0.3))
    parts.append(_path(across(times), height(values)))
    marks = [(top, number(top, 3)), (floor if is_log else bottom, number(floor if is_log else bottom, 3))]
    if limit is not None:
        at = float(height(limit))
        parts.append(f'<path d="M{_LEFT} {at:.1f}H{_WIDTH}" stroke="currentColor" stroke-dasharray="5 4" fill="none"/>')
        marks = [mark for mark in marks if abs(float(height(mark[0])) - at) > 14]
        marks.append((limit, number(limit, 3)))
    parts += [_text(_LEFT - 6, float(height(value)) + 4, text, "end") for value, text in marks]
    words = ends or (number(first), number(last))
    parts += [_text(_LEFT, _HEIGHT - 4, words[0], "start"), _text(_WIDTH, _HEIGHT - 4, words[1], "end")]
    return _svg(_WIDTH, _HEIGHT, label, parts)


def grid(cells: ArrayLike, rows: Sequence[str], columns: Sequence[str], *, label: str) -> str:
    """Return a grid with the set cells filled, as SVG; nothing if it would be empty or too large."""
    filled = np.asarray(cells, dtype=bool)
    if not filled.size or max(filled.shape) > _GRID:
        return ""
    names = [[shortened(visible(name), _NAME) for name in some] for some in (rows, columns)]
    left, above = (8 + 7 * max(map(len, some)) for some in names)
    parts = [_text(left - 6, above + 14 * i + 11, name, "end") for i, name in enumerate(names[0])]
    parts += [
        f'<text transform="translate({left + 14 * j + 11} {above - 6}) rotate(-90)">{escaped(name)}</text>'
        for j, name in enumerate(names[1])
    ]
    for i, row in enumerate(filled):
        for j, cell in enumerate(row):
            look = (_BLUE, 1.0) if cell else ("currentColor", 0.12)
            parts.append(_rect(left + 14 * j, above + 14 * i, 13, 13, *look))
    return _svg(left + 14 * filled.shape[1], above + 14 * filled.shape[0] + 2, label, parts)


def _binned(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a line with few points: the smallest and the largest value of each bin that has any."""
    finite = np.where(np.isfinite(y), y, np.nan)
    if len(x) <= 2 * _BINS:
        return x, finite
    starts = np.linspace(0, len(x), _BINS, endpoint=False).astype(int)
    extremes = [extreme.reduceat(finite, starts) for extreme in (np.fmin, np.fmax)]
    return np.append(np.repeat(x[starts], 2)[:-1], x[-1]), np.stack(extremes, axis=1).ravel()


def _path(x: NDArray[np.float64], y: NDArray[np.float64]) -> str:
    """Return a line, interrupted where it has no value."""
    known = np.isfinite(y)
    starts = known & ~np.concatenate([[False], known[:-1]])
    points = zip(x[known].tolist(), y[known].tolist(), starts[known].tolist(), strict=True)
    drawn = "".join(f"{'M' if begins else 'L'}{a:.1f} {b:.1f}" for a, b, begins in points)
    return f'<path d="{drawn}" stroke="{_BLUE}" stroke-width="1.5" stroke-linecap="round" fill="none"/>'


def _rect(x: float, y: float, width: float, height: float, fill: str, opacity: float) -> str:
    return f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height}" fill="{fill}" opacity="{opacity:g}"/>'


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escaped(text)}</text>'


def _svg(width: float, height: float, label: str, parts: Iterable[str]) -> str:
    """Return a picture with a caption."""
    return (
        f'<figure style="margin:.5em 0"><figcaption>{escaped(label)}</figcaption><svg width="{width}" '
        f'height="{height}" viewBox="0 0 {width} {height}" role="img" aria-label="{escaped(label)}" font-size="11" '
        f'fill="currentColor" style="max-width:100%;height:auto">{"".join(parts)}</svg></figure>'
    )
