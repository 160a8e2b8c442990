"""The direction picture: where the residual points for each fault, and where it was seen to point."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from residua.report.text import escape

_SIZE = 340
_RADIUS = 125.0
#: View from which three residuals are drawn first: turned about the vertical, then tilted, in radians.
_TURN, _TILT = -0.6, 0.45


def direction_picture(
    axes: Sequence[str],
    labels: Sequence[str],
    bases: Sequence[NDArray[np.float64]],
    observed: NDArray[np.float64] | None,
) -> str:
    """Return two or three residual axes with the signature directions as lines through the origin, as SVG.

    Signatures of more than one dimension are left out (the heat map has them). Three axes are drawn in
    perspective; the page's script turns them when dragged.

    Parameters
    ----------
    axes : sequence of str
        Names of the two or three residuals.
    labels : sequence of str
    bases : sequence of ndarray, shape (residuals, k)
        Orthonormal.
    observed : ndarray, shape (residuals,), optional
        The residual that was seen; drawn with unit length.

    Returns
    -------
    str
        Empty when there is nothing to draw.
    """
    n = len(axes)
    if n not in (2, 3):
        return ""
    lines = [(k, label, B[:, 0]) for k, (label, B) in enumerate(zip(labels, bases, strict=True)) if B.shape[1] == 1]
    length = 0.0 if observed is None else float(np.linalg.norm(observed))
    if observed is not None and length > 0:
        lines = [(k, label, v if v @ observed >= 0 else -v) for k, label, v in lines]
    if not lines and not length:
        return ""
    parts = [f'<circle class="sphere" r="{_RADIUS:g}"/>']
    parts += [_line(np.eye(n)[i], "axis", escape(name)) for i, name in enumerate(axes)]
    parts += [_line(v, f"signature c{k % 8}", str(k + 1)) for k, _, v in lines]
    if observed is not None and length > 0:
        parts.append(_line(observed / length, "observed", "seen"))
    half = _SIZE / 2
    legend = "".join(
        f'<li><span class="swatch c{k % 8}"></span><b>{k + 1}</b> {escape(label)}</li>' for k, label, _ in lines
    )
    seen = '<li><span class="swatch observed"></span>observed residual, main alarm</li>' if length else ""
    hint = '<p class="muted screen">Drag the picture to turn it.</p>' if n == 3 else ""
    return (
        f'<div class="directions"><svg class="picture" data-axes="{n}" data-turn="{_TURN}" data-tilt="{_TILT}" '
        f'viewBox="{-half:g} {-half:g} {_SIZE} {_SIZE}" width="{_SIZE}" height="{_SIZE}" role="img" '
        f'aria-label="Signature directions in the space of the residuals">{"".join(parts)}</svg>'
        f'<div><ul class="legend">{legend}{seen}</ul>{hint}</div></div>'
    )


def _line(vector: NDArray[np.float64], kind: str, label: str) -> str:
    """Return a line through the origin with its label beyond the positive end."""
    x, y = project(vector)
    back = 0.0 if kind == "observed" else 1.0
    reach = 1.14 if kind == "axis" else 1.08
    coordinates = ",".join(f"{c:.4f}" for c in vector)
    return (
        f'<g class="{kind}" data-v="{coordinates}">'
        f'<line class="back" x1="0" y1="0" x2="{-back * x:.1f}" y2="{-back * y:.1f}"/>'
        f'<line x1="0" y1="0" x2="{x:.1f}" y2="{y:.1f}"/><circle class="tip" cx="{x:.1f}" cy="{y:.1f}" r="3"/>'
        f'<text x="{reach * x:.1f}" y="{reach * y:.1f}">{label}</text></g>'
    )


def project(vector: NDArray[np.float64], turn: float = _TURN, tilt: float = _TILT) -> tuple[float, float]:
    """Return the picture coordinates of a vector with two or three components (y runs down)."""
    if len(vector) == 2:
        return _RADIUS * float(vector[0]), -_RADIUS * float(vector[1])
    a, b, c = (float(x) for x in vector)
    across = a * np.cos(turn) - b * np.sin(turn)
    depth = a * np.sin(turn) + b * np.cos(turn)
    return _RADIUS * float(across), -_RADIUS * float(c * np.cos(tilt) + depth * np.sin(tilt))
