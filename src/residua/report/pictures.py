"""Direction picture: the direction of the residual for each fault, and the observed one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from residua.report.text import escape

_SIZE = 340
_RADIUS = 125.0
#: View from which three residuals are drawn first: turned about the vertical, then tilted, in radians.
_TURN, _TILT = -0.6, 0.45
#: Corners of the disc that stands for a plane of directions.
_CORNERS = 36


def direction_picture(
    axes: Sequence[str], bases: Sequence[NDArray[np.float64]], observed: NDArray[np.float64] | None
) -> str:
    """Return two or three residual axes with the signatures as numbered lines and discs, as SVG.

    Three axes are drawn in parallel perspective; the page's script turns them when dragged.

    Parameters
    ----------
    axes : sequence of str
        Names of the residuals.
    bases : sequence of ndarray, shape (residuals, k)
        Orthonormal. One column is drawn as a line through the origin, two of three as a disc; an empty
        signature, or one that is the whole space, is left out.
    observed : ndarray, shape (residuals,), optional
        The residual that was seen; drawn with unit length.

    Returns
    -------
    str
        Empty when there is nothing to draw, or neither two nor three residuals.
    """
    n = len(axes)
    if n not in (2, 3):
        return ""
    length = 0.0 if observed is None else float(np.linalg.norm(observed))
    parts = [f'<circle class="sphere" r="{_RADIUS:g}"/>']
    parts += [_line(np.eye(n)[i], "axis", escape(name)) for i, name in enumerate(axes)]
    drawn = 0
    for k, B in enumerate(bases):
        if B.shape[1] == 1:
            along = observed is None or float(B[:, 0] @ observed) >= 0
            parts.append(_line(B[:, 0] if along else -B[:, 0], f"signature c{k % 8}", str(k + 1)))
        elif B.shape[1] == 2 and n == 3:
            parts.insert(1, _disc(B, f"c{k % 8}"))
        drawn += B.shape[1] in range(1, n)
    if observed is not None and length > 0:
        parts.append(_line(observed / length, "observed", "seen"))
    if not drawn and not length:
        return ""
    half = _SIZE / 2
    hint = '<p class="muted screen">Drag the picture, or use the arrow keys, to turn it.</p>' if n == 3 else ""
    focus = ' tabindex="0"' if n == 3 else ""
    return (
        f'<div><svg class="picture" data-axes="{n}" data-turn="{_TURN}" data-tilt="{_TILT}" '
        f'viewBox="{-half:g} {-half:g} {_SIZE} {_SIZE}" width="{_SIZE}" height="{_SIZE}" role="img"{focus} '
        f'aria-label="Signature directions in the space of the residuals">{"".join(parts)}</svg>{hint}</div>'
    )


def _line(vector: NDArray[np.float64], kind: str, label: str) -> str:
    """Return a line through the origin with its label beyond the positive end."""
    x, y = project(vector)
    back = 0.0 if kind == "observed" else 1.0
    reach = 1.16 if kind == "axis" else 1.08
    return (
        f'<g class="{kind}" data-v="{_coordinates(vector)}">'
        f'<line class="back" x1="0" y1="0" x2="{-back * x:.1f}" y2="{-back * y:.1f}"/>'
        f'<line x1="0" y1="0" x2="{x:.1f}" y2="{y:.1f}"/><circle class="tip" cx="{x:.1f}" cy="{y:.1f}" r="3"/>'
        f'<text x="{reach * x:.1f}" y="{reach * y:.1f}">{label}</text></g>'
    )


def _disc(basis: NDArray[np.float64], colour: str) -> str:
    """Return the unit circle of a plane, corner by corner."""
    turns = 2 * np.pi * np.arange(_CORNERS) / _CORNERS
    rim = np.outer(np.cos(turns), basis[:, 0]) + np.outer(np.sin(turns), basis[:, 1])
    points = " ".join("{:.1f},{:.1f}".format(*project(v)) for v in rim)
    rim_text = ";".join(_coordinates(v) for v in rim)
    return f'<polygon class="plane {colour}" data-rim="{rim_text}" points="{points}"/>'


def _coordinates(vector: NDArray[np.float64]) -> str:
    return ",".join(f"{c:.3f}" for c in vector)


def project(vector: NDArray[np.float64], turn: float = _TURN, tilt: float = _TILT) -> tuple[float, float]:
    """Return the picture coordinates of a vector with two or three components (y runs down)."""
    if len(vector) == 2:
        return _RADIUS * float(vector[0]), -_RADIUS * float(vector[1])
    a, b, c = (float(x) for x in vector)
    across = a * np.cos(turn) - b * np.sin(turn)
    depth = a * np.sin(turn) + b * np.cos(turn)
    return _RADIUS * float(across), -_RADIUS * float(c * np.cos(tilt) + depth * np.sin(tilt))
