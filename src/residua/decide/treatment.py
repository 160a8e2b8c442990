"""Treatment of residuals: whitening, autoregression, and scores for heavy tails."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.autoregression import Past, autoregression, unforetold, whiteness
from residua.decide.calibrate import ResidualModel
from residua.decide.fault_free import FaultFree
from residua.decide.normal_scores import is_heavy_tailed, knots_of
from residua.decide.row_norms import row_squares
from residua.decide.stream_test import plain
from residua.decide.test import Block, FaultFreeRun
from residua.decide.whitened_norm import whitened_residuals
from residua.errors import DataError
from residua.linear.subspaces.whitening import VARIANCE_FLOOR
from residua.tolerances import SIGNAL_ROUNDING
from residua.words import counted, number

#: Probability that white noise looks as coloured, below which it is taken to be coloured.
_COLOURED = 0.01
#: Standard deviations by which the ends of a stretch of time may be off its mean, and stretches that data are cut into.
_ENDS, _FOLDS = 3.0, 4
#: Error of a mean that does not matter where it is simulated, in deviations.
_HARMLESS = 1.0
#: Parts of the variance of white noise below which a direction is rounding.
_STILL = VARIANCE_FLOOR**0.5


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
    shrinkage : float
        How far the covariance was drawn towards a simpler one; 0 if the data sufficed.
    varies : ndarray of bool, shape (k,), or None
        Parts of the innovations that are neither constant nor predicted exactly; ``None`` if that is not known.
    """

    parts: dict[str, Any]
    moving: int
    notes: list[str]
    is_heavy: bool
    shrinkage: float = 0.0
    varies: NDArray[np.bool_] | None = None


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
    everything = np.zeros(len(parts["center"]), dtype=bool)
    everything[live[varies]] = True
    return Treated(parts, moving, notes, is_heavy, whole.intensity, everything)


@dataclass(frozen=True, eq=False)
class ResidualFit:
    """Treatment of the parts of a residual, side by side, and the model of what it leaves.

    Attributes
    ----------
    parts : dict
        As of :class:`Treated`, with the whitened residuals of one part after those of another.
    columns : list of slice
        Whitened residuals of each part.
    moving : list of int
        Independent directions of each part.
    model : ResidualModel
    notes : list of str
    """

    parts: dict[str, Any]
    columns: list[slice]
    moving: list[int]
    model: ResidualModel
    notes: list[str]


def fit_parts(made: Sequence[Treated], rows: Sequence[Sequence[int]], run: FaultFreeRun) -> ResidualFit:
    """Return the joint model of residuals that are treated part by part."""
    columns = columns_of(rows)
    parts = side_by_side([one.parts for one in made], rows, run.residuals.shape[1])
    e = np.concatenate(innovations_of(parts, run))
    covariance = e.T @ e / max(1, len(e))
    for part in columns:  # each is white by itself; directions without noise are left out
        covariance[part, part] = np.diag((np.diag(covariance[part, part]) > _STILL).astype(float))
    heavy = [one.is_heavy and not one.parts["scores"].size for one in made]
    radii = tuple(
        np.sort(np.sqrt(row_squares(e[:, part]))) if one else None for part, one in zip(columns, heavy, strict=True)
    )
    model = ResidualModel(
        parts["coefficients"],
        parts["rewhitening"],
        covariance,
        tuple(columns),
        radii,
        int(run.usable.sum()),
        parts["knots"],
        parts["scores"],
    )
    notes = list(dict.fromkeys(note for one in made for note in one.notes))
    return ResidualFit(parts, columns, [max(one.moving, 1) for one in made], model, notes)


def whitened_part(treatment: str, run: FaultFreeRun, rows: Sequence[int]) -> Treated:
    """Return the whitening of some residuals; those without noise are scaled by their largest value."""
    data = FaultFree(run.residuals[:, list(rows)], run.usable, 1, run.seams)
    rounding = SIGNAL_ROUNDING * run.signal_size(rows)
    if data.spread > rounding:
        try:
            return treated(data, treatment, _HARMLESS, scores=False)
        except DataError:  # its past predicts all of it: it is judged unchanged
            return treated(data, "none", _HARMLESS, scores=False)
    size = max(float(np.abs(data.deviations).max(initial=0.0)), rounding, float(np.finfo(float).tiny))
    parts = plain(data.middle, np.eye(len(rows)) / size)
    return Treated(parts, len(rows), ["no noise in these data: the threshold is at rounding level"], False)


def innovations_of(parts: Mapping[str, Any], run: FaultFreeRun) -> list[NDArray[np.float64]]:
    """Return the white residuals of each recording that has some, at samples where they are known."""
    A, out = parts["coefficients"], []
    for part in FaultFree(run.residuals, run.usable, 1, run.seams).parts:
        q, usable = whitened_residuals(
            parts["center"], parts["whitening"], Block(run.residuals[None, part], run.usable[None, part])
        )
        e, seen, _ = unforetold(A, Past.empty(1, A), q, usable)
        if seen.any():
            out.append((e[0] @ parts["rewhitening"] if A.size else e[0])[seen[0]])
    return out


def inverse_of(whitening: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse of a whitening matrix, whatever the units of the residuals are."""
    sizes = np.sqrt(np.sum(whitening**2, axis=1, keepdims=True))
    sizes = np.where(sizes > 0, sizes, 1.0)
    return np.linalg.pinv(whitening / sizes) / sizes.T


def columns_of(rows: Sequence[Sequence[int]]) -> list[slice]:
    """Return the columns of the whitened residuals of each part."""
    ends = np.cumsum([len(one) for one in rows]).tolist()
    return [slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True)]


def side_by_side(made: Sequence[Mapping[str, Any]], rows: Sequence[Sequence[int]], n: int) -> dict[str, Any]:
    """Return the joint whitening of the residuals of all parts."""
    if len(made) == 1 and list(rows[0]) == list(range(n)):
        return dict(made[0])
    columns = columns_of(rows)
    k, order = columns[-1].stop, max(len(one["coefficients"]) for one in made)
    parts = {**plain(np.zeros(n), np.zeros((n, k))), "coefficients": np.zeros((order, k, k)), "rewhitening": np.eye(k)}
    parts["knots"] = np.zeros((k, 0))
    for one, mine, part in zip(made, rows, columns, strict=True):
        parts["center"][list(mine)] = one["center"]
        parts["whitening"][list(mine), part] = one["whitening"]
        parts["coefficients"][: len(one["coefficients"]), part, part] = one["coefficients"]
        parts["rewhitening"][part, part] = one["rewhitening"]
    return parts


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


__all__ = [
    "ResidualFit",
    "Treated",
    "columns_of",
    "fit_parts",
    "innovations_of",
    "inverse_of",
    "side_by_side",
    "treated",
    "whitened_part",
]
