"""Fit of a bank of means: white residuals, the covariance of their means, and levels of held-out data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua.decide.calibrate import held_out, levels_of
from residua.decide.row_norms import row_squares
from residua.decide.test import FaultFreeRun, Watched
from residua.decide.treatment import ResidualFit, fit_parts, innovations_of, whitened_part
from residua.errors import DataError
from residua.linear.subspaces.whitening import VARIANCE_FLOOR
from residua.linear.systems.recursion import run_filter

#: Normal score of the length at which a sample is clipped before it enters the long means.
CLIP = 3.0
#: Part of the threshold, as a normal score, at or below which an alarm ends.
FALLS_TO = 0.5
#: Samples of a mean that a fit leaves to its start, in units of its memory, and the most of a recording.
_STARTING, _MOST_STARTING = 2.0, 0.25
#: Parts of the variance of white noise below which a mean is rounding.
_STILL = VARIANCE_FLOOR**0.5
#: Independent exceedances by which scales are made alike.
_EXCEEDANCES = 20


@dataclass(frozen=True, eq=False)
class MeansFit(ResidualFit):
    """Residual model and means of a fit, before the threshold."""

    scaling: NDArray[np.float64]


def fit_means(weights: Sequence[float], treatment: str, rows: Sequence[Sequence[int]], run: FaultFreeRun) -> MeansFit:
    """Fit the whitening of residuals, and the covariance of their means, to the usable samples of a run."""
    fit = fit_parts([whitened_part(treatment, run, one) for one in rows], rows, run)
    blank = MeansFit(**vars(fit), scaling=np.zeros(0))
    series = innovations_of(fit.parts, run)
    scaling = [scaled_anew(means_of(weight, series, blank), fit.columns, weight, 1.0) for weight in weights]
    return replace(blank, scaling=np.concatenate(scaling))


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
    out = []
    for others, mine in held_out(run):
        try:
            fit = fit_means(weights, treatment, rows, others)
        except DataError:  # too few samples remain for a fit
            return np.zeros(0)
        for e in innovations_of(fit.parts, mine):
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
    "factors_of",
    "fit_means",
    "held_out_levels",
    "lengths_at",
    "means_of",
    "rows_of_parts",
    "scaled",
    "scaled_anew",
    "scores_of",
    "variance_of",
]
