"""Treatment of residuals: whitening, autoregression, and scores for heavy tails."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.autoregression import Past, autoregression, unforetold, whiteness
from residua.decide.fault_free import FaultFree
from residua.decide.normal_scores import is_heavy_tailed, knots_of
from residua.decide.stream_test import plain
from residua.errors import DataError
from residua.linear.subspaces.whitening import VARIANCE_FLOOR
from residua.words import counted, number

#: Probability that white noise looks as coloured, below which it is taken to be coloured.
_COLOURED = 0.01
#: Standard deviations by which the ends of a stretch of time may be off its mean, and stretches that data are cut into.
_ENDS, _FOLDS = 3.0, 4


@dataclass(frozen=True, eq=False)
class Treated:
    """Treatment that makes fault-free residuals white and Gaussian.

    Attributes
    ----------
    parts : dict
        Fields of a :class:`residua.decide.stream_test.StreamTest`: ``center``, ``whitening``, ``coefficients``,
        ``rewhitening``, ``knots`` and ``scores``.
    moving : int
        Independent directions that are left.
    notes : list of str
        Remarks on it.
    is_heavy : bool
        Whether the innovations have heavy tails.
    """

    parts: dict[str, Any]
    moving: int
    notes: list[str]
    is_heavy: bool


def treated(data: FaultFree, treatment: str, harmless_offset: float, *, scores: bool = True) -> Treated:
    """Fit the treatment that makes fault-free residuals white and Gaussian.

    Parameters
    ----------
    data : FaultFree
    treatment : {"auto", "none"}
        Whether an autoregression and scores are looked for, or the covariance alone.
    harmless_offset : float
        Error of a mean, in standard deviations, that does not matter to the test.
    scores : bool
        Whether heavy tails are made Gaussian.
    """
    whole, moving = data.moments(), data.moving
    parts, notes = plain(whole.center, whole.whitening), []
    if whole.intensity:
        notes.append(f"covariance of too few samples, shrunk by {whole.intensity:.2g} towards a simpler one")
    q = np.where(data.usable[:, None], (data.residuals - whole.center) @ whole.whitening, 0.0)
    if moving < q.shape[1]:
        notes.append(f"{moving} of the {q.shape[1]} residuals are independent")
    # Combinations of residuals that noise never moves hold nothing but rounding, which no model is for.
    live = np.sort(np.argsort(np.sum(q**2, axis=0))[q.shape[1] - moving :])
    q = q[:, live]
    model = None
    if treatment == "auto" and whiteness(q, data.usable, data.parts) < _COLOURED:
        model = autoregression(q, data.usable, data.parts)
        if not model.order:
            notes.append("the residual is correlated in time in a way that no autoregression fits")
    e, varies = q[data.usable], np.ones(len(live), dtype=bool)
    if model is not None and model.order:
        e = np.concatenate([_innovations(model.coefficients, q[part], data.usable[part]) for part in data.parts])
        values, vectors = np.linalg.eigh(e.T @ e / max(len(e), 1))  # in parts of the variance of each direction
        floor = _floor(len(e), harmless_offset)
        V = vectors / np.sqrt(np.maximum(values, floor))
        notes.append(f"correlated in time: a prediction from the last {model.order} samples is subtracted")
        varies = values > floor
        exact = int(np.count_nonzero(~varies))
        if exact == moving:
            raise DataError(
                f"the past predicts all but {number(float(values[-1]), 2)} of the variance of this residual, "
                f"which {len(e)} samples cannot distinguish from an error of their mean: give more, or fit with "
                "treatment='none'"
            )
        if exact:
            notes.append(f"{counted(exact, 'combination')} of residuals predicted exactly")
            moving -= exact
        k, e = len(parts["center"]), e @ V
        coefficients, rewhitening = np.zeros((model.order, k, k)), np.eye(k)
        coefficients[:, live[:, None], live] = model.coefficients
        rewhitening[live[:, None], live] = V
        parts = {**parts, "coefficients": coefficients, "rewhitening": rewhitening}
    is_heavy = treatment == "auto" and is_heavy_tailed(e[:, varies])
    if is_heavy and scores:
        knots, values = knots_of(e[:, varies])
        notes.append("heavy tails: each value is replaced by its normal score")
        # directions that never move, or are predicted exactly, stay unchanged: rounding, and the ends of recordings
        everywhere = np.tile(values, (len(parts["center"]), 1))
        everywhere[live[varies]] = knots
        parts = {**parts, "knots": everywhere, "scores": values}
    return Treated(parts, moving, notes, is_heavy)


def _floor(samples: int, harmless_offset: float) -> float:
    """Return the share of variance below which a direction's innovations are less than the error of its mean.

    Where decoupling makes residuals depend on each other over time, an autoregression predicts combinations of them
    exactly. Their only innovations, at the ends of a recording, divided by its length, are all the noise they have.
    """
    return max(VARIANCE_FLOOR, (_ENDS * _FOLDS / max(samples, 1) / harmless_offset) ** 2)


def _innovations(
    coefficients: NDArray[np.float64], q: NDArray[np.float64], usable: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return the innovations of the samples whose past is known."""
    e, seen, _ = unforetold(coefficients, Past.empty(1, coefficients), q[None], usable[None])
    return e[0, seen[0]]


__all__ = ["Treated", "treated"]
