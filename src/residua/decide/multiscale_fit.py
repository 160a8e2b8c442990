"""Fit of a bank of means: white residuals, the covariance of their means, and levels of held-out data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.autoregression import Past, unforetold
from residua.decide.calibrate import ResidualModel, levels_of
from residua.decide.fault_free import FaultFree
from residua.decide.row_norms import row_squares
from residua.decide.stream_test import plain
from residua.decide.test import Block, FaultFreeRun, Watched
from residua.decide.treatment import Treated, treated
from residua.decide.whitened_norm import whitened_residuals
from residua.errors import DataError
from residua.linear.subspaces.whitening import VARIANCE_FLOOR
from residua.linear.systems.recursion import run_filter
from residua.tolerances import SIGNAL_ROUNDING

#: Normal score of the length at which a sample is clipped before it enters the long means.
CLIP = 3.0
#: Part of the threshold, as a normal score, at or below which an alarm ends.
FALLS_TO = 0.5
#: Error of a mean that does not matter, in deviations: it is simulated.
_HARMLESS = 1.0
#: Samples of a mean that a fit leaves to its start, in units of its memory, and the most of a recording.
_STARTING, _MOST_STARTING = 2.0, 0.25
#: Parts of the variance of white noise below which a mean is rounding.
_STILL = VARIANCE_FLOOR**0.5
#: Independent exceedances by which scales are made alike.
_EXCEEDANCES = 20
#: Stretches of the data that are judged by the others.
_FOLDS = 4


@dataclass(frozen=True, eq=False)
class MeansFit:
    """Residual model and means of a fit, before the threshold."""

    parts: dict[str, Any]
    scaling: NDArray[np.float64]
    columns: list[slice]
    moving: list[int]
    model: ResidualModel
    notes: list[str]


def fit_means(weights: Sequence[float], treatment: str, rows: Sequence[Sequence[int]], run: FaultFreeRun) -> MeansFit:
    """Fit the whitening of residuals, and the covariance of their means, to the usable samples of a run."""
    columns, made = columns_of(rows), [_treated(treatment, run, one) for one in rows]
    parts = side_by_side([one.parts for one in made], rows, run.residuals.shape[1])
    series = _white(parts, run)
    e = np.concatenate(series)
    covariance = e.T @ e / max(1, len(e))
    for part in columns:  # each is white by itself; directions without noise are left out
        covariance[part, part] = np.diag((np.diag(covariance[part, part]) > _STILL).astype(float))
    radii = tuple(
        np.sort(np.sqrt(row_squares(e[:, part]))) if one.is_heavy else None
        for part, one in zip(columns, made, strict=True)
    )
    model = ResidualModel(
        parts["coefficients"], parts["rewhitening"], covariance, tuple(columns), radii, int(run.usable.sum())
    )
    notes = list(dict.fromkeys(note for one in made for note in one.notes))
    fit = MeansFit(parts, np.zeros(0), columns, [max(one.moving, 1) for one in made], model, notes)
    scaling = [scaled_anew(means_of(weight, series, fit), columns, weight, 1.0) for weight in weights]
    return replace(fit, scaling=np.concatenate(scaling))


def _treated(treatment: str, run: FaultFreeRun, rows: Sequence[int]) -> Treated:
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


def _white(parts: Mapping[str, Any], run: FaultFreeRun) -> list[NDArray[np.float64]]:
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


def means_of(weight: float, series: Sequence[NDArray[np.float64]], fit: MeansFit) -> list[NDArray[np.float64]]:
    """Return the means of white residuals, of one or several series (..., time, k), each with its own start."""
    if weight == 1:
        return list(series)
    out = []
    for e in series:
        entering = clipped(e, fit.columns, lengths_at(CLIP, fit.moving))
        rows = entering.reshape(-1, *entering.shape[-2:])
        out.append(averaged(weight, np.zeros((len(rows), e.shape[-1])), rows)[0].reshape(e.shape))
    return out


def scaled_anew(
    means: NDArray[np.float64] | Sequence[NDArray[np.float64]], columns: Sequence[slice], weight: float, shrink: float
) -> NDArray[np.float64]:
    """Return matrices that normalise means by their own covariance; shape (fits, k, k).

    Of one fit to several recordings, or of many fits to one each. What a mean takes to start is left out. Of few rows,
    the covariance is drawn towards that of the mean of white residuals.
    """
    several = [means] if isinstance(means, np.ndarray) else list(means)
    k, total, rows = several[0].shape[-1], 0.0, 0
    for one in several:
        settled = one[..., min(int(_STARTING / weight), int(_MOST_STARTING * one.shape[-2])) :, :]
        total = total + np.swapaxes(settled, -1, -2) @ settled
        rows += settled.shape[-2]
    if weight == 1:
        return np.broadcast_to(np.eye(k), (*np.shape(total)[:-2], k, k)).reshape(-1, k, k)
    own = np.asarray(total).reshape(-1, k, k) / max(rows, 1)
    own = own.mean(axis=0) + shrink * (own - own.mean(axis=0))
    worth, prior = rows * weight / shrink**2, k + 2
    return scaled((worth * own + prior * variance_of(weight) * np.eye(k)) / (worth + prior), columns, weight)


def scaled(covariances: NDArray[np.float64], columns: Sequence[slice], weight: float) -> NDArray[np.float64]:
    """Return the inverse roots of the covariances of a mean, part by part; directions without variance are white."""
    out = np.zeros_like(covariances)
    for part in columns:
        values, vectors = np.linalg.eigh(covariances[..., part, part])
        values = np.where(values > _STILL * variance_of(weight), values, variance_of(weight))
        out[..., part, part] = vectors / np.sqrt(values)[..., None, :] @ np.swapaxes(vectors, -1, -2)
    return out


def factors_of(mean: NDArray[np.float64], fit: MeansFit, weight: float, rate: float) -> NDArray[np.float64]:
    """Return for each column the factor of the simulated means over standard normal vectors, at a rate.

    At the rate asked for, or at the rarest that twenty independent exceedances show.
    """
    from scipy.special import chdtri  # slow to import, and needed only here

    shown = max(rate, _EXCEEDANCES * (2 / weight - 1) / mean[..., 0].size)
    out = np.ones(mean.shape[-1])
    for part, k in zip(fit.columns, fit.moving, strict=True):
        square = float(np.quantile(row_squares(mean[..., part]), 1 - shown))
        out[part] = max(1.0, np.sqrt(square / float(chdtri(k, shown))))
    return out


def scores_of(means: Sequence[NDArray[np.float64]], fit: MeansFit) -> NDArray[np.float64]:
    """Return the normal score of the longest mean of any part."""
    scores = []
    for part, k in zip(fit.columns, fit.moving, strict=True):
        square = np.max([row_squares(mean[..., part]) for mean in means], axis=0)
        scores.append((np.cbrt(square / k) - (1 - 2 / (9 * k))) / np.sqrt(2 / (9 * k)))
    return np.max(scores, axis=0)


def held_out_levels(
    weights: Sequence[float],
    treatment: str,
    rows: Sequence[Sequence[int]],
    run: FaultFreeRun,
    factors: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the levels of each quarter of the samples by a fit to the others; none if they are too few."""
    count = np.cumsum(run.usable)
    edges = np.searchsorted(count, np.arange(_FOLDS + 1) * count[-1] / _FOLDS)
    out = []
    for start, stop in pairwise([0, *edges[1:-1].tolist(), len(count)]):
        others = run.usable.copy()
        others[start:stop] = False
        mine = replace(run, usable=run.usable & ~others)
        try:
            fit = fit_means(weights, treatment, rows, replace(run, usable=others))
        except DataError:  # too few samples remain for a fit
            return np.zeros(0)
        for e in _white(fit.parts, mine):
            if len(e):
                means = [
                    means_of(weight, [e], fit)[0] @ (M / g)
                    for weight, M, g in zip(weights, fit.scaling, factors, strict=True)
                ]
                out.append(levels_of(scores_of(means, fit)[None], FALLS_TO)[0])
    return np.concatenate(out) if out else np.zeros(0)


def rows_of_parts(watched: Watched) -> list[list[int]]:
    """Return the residuals of each part, or all of them."""
    if watched.parts is None:
        return [list(range(watched.generator.n_residuals))]
    return [list(rows) for rows in watched.parts.values()]


def columns_of(rows: Sequence[Sequence[int]]) -> list[slice]:
    """Return the columns of the whitened residuals of each part."""
    ends = np.cumsum([len(one) for one in rows]).tolist()
    return [slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True)]


def side_by_side(made: Sequence[Mapping[str, Any]], rows: Sequence[Sequence[int]], n: int) -> dict[str, Any]:
    """Return the joint whitening of the residuals of all parts."""
    columns = columns_of(rows)
    k, order = columns[-1].stop, max(len(one["coefficients"]) for one in made)
    parts = {**plain(np.zeros(n), np.zeros((n, k))), "coefficients": np.zeros((order, k, k)), "rewhitening": np.eye(k)}
    parts["knots"] = np.zeros((k, 0))
    for one, mine, part in zip(made, rows, columns, strict=True):
        parts["center"][mine] = one["center"]
        parts["whitening"][mine, part] = one["whitening"]
        parts["coefficients"][: len(one["coefficients"]), part, part] = one["coefficients"]
        parts["rewhitening"][part, part] = one["rewhitening"]
    return parts


def clipped(e: NDArray[np.float64], columns: Sequence[slice], clips: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return samples limited to the clips of their parts."""
    out = np.empty_like(e)
    for part, clip in zip(columns, clips.tolist(), strict=True):
        square = row_squares(e[..., part])
        factor = np.where(square > clip * clip, clip / np.sqrt(np.where(square > 0, square, 1.0)), 1.0)
        out[..., part] = e[..., part] * factor[..., None]
    return out


def averaged(
    weight: float, mean: NDArray[np.float64], rows: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the mean after each of some rows, (series, time, k), and after the last."""
    one = np.eye(mean.shape[1])
    last, means = run_filter((1 - weight) * one, weight * one, (1 - weight) * one, weight * one, mean, rows)
    return means, last


def variance_of(weight: float) -> float:
    """Return the steady-state variance of the mean of white residuals."""
    return weight / (2 - weight)


def lengths_at(score: float, moving: Sequence[int]) -> NDArray[np.float64]:
    """Return the lengths of standard normal vectors that have a normal score (Wilson and Hilferty)."""
    k = np.asarray(moving, dtype=float)
    return np.sqrt(k * np.maximum(1 - 2 / (9 * k) + score * np.sqrt(2 / (9 * k)), 0.0) ** 3)


__all__ = [
    "CLIP",
    "FALLS_TO",
    "MeansFit",
    "averaged",
    "clipped",
    "columns_of",
    "factors_of",
    "fit_means",
    "held_out_levels",
    "lengths_at",
    "means_of",
    "rows_of_parts",
    "scaled",
    "scaled_anew",
    "scores_of",
    "side_by_side",
    "variance_of",
]
