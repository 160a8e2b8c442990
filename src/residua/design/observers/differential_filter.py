"""Differential polynomials of signals: their coefficients without rounding, and the filters that apply them."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import numpy as np
from numpy.typing import NDArray

from residua import arrays
from residua.linear import StateSpace

#: Coefficients, and for each of their entries the sum of the magnitudes of the terms that it is made of.
Terms = tuple[NDArray[np.float64], NDArray[np.float64]]


def trimmed(coefficients: Sequence[Terms], rate: float, rtol: float = 1e-12) -> list[NDArray[np.float64]]:
    """Return a polynomial without the highest coefficients that are rounding, and with zeros for entries that are.

    A signal that was decoupled is then not read at all, where rounding of its terms would read it faintly.

    Parameters
    ----------
    coefficients : sequence of tuple of ndarray
        ``P_0, P_1, ...`` in balanced units, each with the sizes of its terms.
    rate : float
        The rate at which derivatives are compared with one another.
    rtol : float
        Coefficients below this fraction of what their row and their column are made of count as rounding.
    """
    total = sum(rate**i * size for i, (_, size) in enumerate(coefficients))
    columns = np.max(total, axis=0, keepdims=True, initial=0.0)
    columns = np.where(columns > 0, columns, 1.0)
    floor = rtol * np.max(total / columns, axis=1, keepdims=True, initial=0.0) * columns
    out = [np.where(rate**i * np.abs(P) > floor, P, 0.0) for i, (P, _) in enumerate(coefficients)]
    while len(out) > 1 and not np.any(out[-1]):
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

    from :math:`s g = (1 - g) / \tau`. Sampled time: :math:`\sum_i P_i v_{k - m + i}`, a delay of ``m`` steps. The lags
    are those of the outputs, or those of the inputs where these are fewer.

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
    degree, width, height = len(coefficients) - 1, len(inputs), len(outputs)
    m = degree if order is None else order
    Q = [np.zeros((height, width))] * (m + 1)
    if dt or m == 0:
        for i, P in enumerate(coefficients):
            Q[m - i] = P
    else:
        assert bandwidth is not None
        for i, P in enumerate(coefficients):
            for k in range(i + 1):
                Q[m - i + k] = Q[m - i + k] + bandwidth**i * (-1) ** k * comb(i, k) * P
    # before the states, which would be many where powers of the bandwidth run away
    for one in Q:
        arrays.matrix(one, "coefficient", (height, width))
    rate = 1.0 if dt or bandwidth is None else bandwidth
    chain = np.eye(m, k=-1) if dt else rate * (np.eye(m, k=-1) - np.eye(m))
    if height <= width:  # lags of what comes out, all of which the outputs see
        eye = np.eye(height)
        A, B, C = np.kron(chain.T, eye), np.vstack([np.zeros((0, width)), *Q[1:]]), rate * np.kron(np.eye(1, m), eye)
    else:  # lags of what goes in
        eye = np.eye(width)
        A, B, C = np.kron(chain, eye), rate * np.kron(np.eye(m, 1), eye), np.hstack([np.zeros((height, 0)), *Q[1:]])
    k = m * len(eye)
    return StateSpace(
        A.reshape(k, k), B.reshape(k, width), C.reshape(height, k), Q[0], dt=dt, inputs=inputs, outputs=outputs
    )
