"""What the inputs of a recording can show: how far the past determines them, and when they first move an output."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.identify.hankel_factor import HankelFactor, regress
from residua.tolerances import RANK

#: Standard errors that the effect of an input must reach to count as one.
_EFFECT = 4.0


@dataclass(frozen=True, eq=False)
class Excitation:
    """The inputs of a recording, as far as a model depends on them.

    Attributes
    ----------
    unexplained : ndarray, shape (inputs,)
        The part of each input's variance that neither the past nor the other inputs determine (nor, without
        feedthrough, the outputs of the same row): from it alone the effect of the input is told from that of a
        controller.
    delays : ndarray of int, shape (outputs, inputs)
        The first row after which an input moves an output by more than four standard errors; -1 where none does
        within the past.
    instant : tuple of (int, int)
        Output and input that move together within a row.
    """

    unexplained: NDArray[np.float64]
    delays: NDArray[np.int_]
    instant: tuple[tuple[int, int], ...]


def excitation(factor: HankelFactor, past: int, *, feedthrough: bool) -> Excitation:
    """Return what the inputs can show, from windows of ``past`` rows and the one after them.

    Without feedthrough an input that goes with the output of its row is moved by it.
    """
    m, now = factor.n_inputs, past
    before = factor.R[:, [0, *factor.signals(range(past))]]
    u = factor.R[:, factor.inputs(now)]
    together = factor.R[:, [] if feedthrough else factor.outputs(now)]
    unexplained = np.ones(m)
    power = np.linalg.norm(u - np.outer(before[:, 0], before[:, 0] @ u) / (before[:, 0] @ before[:, 0]), axis=0)
    for i in range(m):
        rest = regress(u[:, [i]], np.hstack([before, np.delete(u, i, axis=1), together])).residual
        unexplained[i] = float(np.linalg.norm(rest) / max(power[i], np.finfo(float).tiny)) ** 2
    delays, instant = _delays(factor, past)
    return Excitation(unexplained, delays, instant)


def _delays(factor: HankelFactor, past: int) -> tuple[NDArray[np.int_], tuple[tuple[int, int], ...]]:
    """Return the first rows with an effect, by the standard errors of an autoregression with the inputs at each row."""
    m, p, n = factor.n_inputs, factor.n_outputs, factor.n_channels
    columns = [0, *factor.signals(range(past)), *factor.inputs(past)]
    X, y = factor.R[:, columns], factor.R[:, factor.outputs(past)]
    fit = regress(y, X)
    size = np.linalg.norm(X, axis=0)
    size = np.where(size > 0, size, 1.0)
    spread = np.linalg.norm(np.linalg.pinv(X / size, rcond=RANK), axis=1) / size
    noise = np.linalg.norm(fit.residual, axis=0) / np.sqrt(max(factor.windows - len(columns), 1))
    scale = np.maximum(np.outer(noise, spread), np.finfo(float).tiny)
    strength = np.abs(fit.coefficients) / scale
    now = strength[:, 1 + past * n :] > _EFFECT
    delays = np.full((p, m), -1)
    for row in reversed(range(1, past + 1)):
        first = 1 + (past - row) * n
        delays = np.where(strength[:, first : first + m] > _EFFECT, row, delays)
    pairs = tuple((int(i), int(j)) for i, j in zip(*np.nonzero(now), strict=True))
    return np.asarray(delays, dtype=int), pairs
