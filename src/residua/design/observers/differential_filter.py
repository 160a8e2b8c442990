"""Differential polynomials of signals: their coefficients without rounding, and the filters that apply them."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import numpy as np
from numpy.typing import NDArray

from residua import arrays
from residua.linear import StateSpace
from residua.tolerances import above_rounding


def trimmed(
    coefficients: Sequence[NDArray], sizes: Sequence[NDArray], rate: float, rtol: float = 1e-12
) -> list[NDArray]:
    """Return a polynomial without the highest coefficients that are rounding, and with zeros for entries that are.

    A signal that was decoupled is then not read at all, where rounding of its terms would read it faintly.

    Parameters
    ----------
    coefficients, sizes : sequence of ndarray
        ``P_0, P_1, ...`` and for each the sum of the magnitudes of the terms that it is made of.
    rate : float
        The rate in rad/s at which derivatives are compared with one another.
    rtol : float
        Coefficients below this fraction of what their row and their column are made of count as rounding.
    """
    out = [above_rounding(P, size) for P, size in zip(coefficients, sizes, strict=True)]
    total = sum(rate**i * size for i, size in enumerate(sizes))
    columns = np.max(total, axis=0, keepdims=True, initial=0.0)
    columns = np.where(columns > 0, columns, 1.0)
    rows = np.max(total / columns, axis=1, keepdims=True, initial=0.0)
    floor = rtol * np.where(rows > 0, rows, 1.0) * columns
    while len(out) > 1 and not np.any(rate ** (len(out) - 1) * np.abs(out[-1]) > floor):
        out.pop()
    return out


def differential_filter(
    coefficients: Sequence[NDArray],
    *,
    dt: float,
    bandwidth: float | None,
    order: int | None = None,
    inputs: Sequence[str],
    outputs: Sequence[str],
) -> StateSpace:
    r"""Return a filter that applies :math:`\sum_i P_i \, d^i / dt^i` to its inputs.

    Continuous time: through ``m`` equal lags, :math:`g = 1 / (\tau s + 1)`, ``tau = 1 / bandwidth``:

    .. math:: \sum_i P_i \frac{s^i}{(\tau s + 1)^m} = \sum_{j=0}^m Q_j\, g^j, \qquad
              Q_j = \sum_i \tau^{-i} (-1)^{k} \binom{i}{k} P_i, \quad k = j - m + i

    from :math:`s g = (1 - g) / \tau`. Sampled time: :math:`\sum_i P_i v_{k - m + i}`, a delay of ``m`` steps.

    Parameters
    ----------
    coefficients : sequence of ndarray, shape (outputs, inputs)
        ``P_0, P_1, ...``.
    dt : float
    bandwidth : float or None
        In rad/s; not used in sampled time, nor without derivatives.
    order : int, optional
        ``m``; the number of derivatives when omitted.
    inputs, outputs : sequence of str

    Returns
    -------
    StateSpace
    """
    degree = len(coefficients) - 1
    m = degree if order is None else order
    width, height = len(inputs), len(outputs)
    zero = np.zeros((height, width))
    Q = [zero] * (m + 1)
    if dt or m == 0:
        for i, P in enumerate(coefficients):
            Q[m - i] = P
    else:
        assert bandwidth is not None
        for i, P in enumerate(coefficients):
            for k in range(i + 1):
                Q[m - i + k] = Q[m - i + k] + bandwidth**i * (-1) ** k * comb(i, k) * P
    # before the states, which would be many where powers of the bandwidth run away
    C = arrays.matrix(np.hstack([np.zeros((height, 0)), *Q[1:]]), "C", (height, m * width))
    eye = np.eye(width)
    links = np.eye(m, k=-1)
    rate = 0.0 if bandwidth is None else bandwidth
    chain = links if dt else rate * (links - np.eye(m))
    first = np.eye(m, 1) * (1.0 if dt else rate)
    A, B = np.kron(chain, eye), np.kron(first, eye)
    return StateSpace(A.reshape(m * width, m * width), B, C, Q[0], dt=dt, inputs=inputs, outputs=outputs)
