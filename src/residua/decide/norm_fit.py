"""Fit of thresholds on norms: of the residual as a whole, or of each of its parts, by simulated worlds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua.decide.calibrate import (
    LEAST_ROWS,
    SETTLING,
    Calibration,
    calibrated,
    held_out,
    inverse_root,
    persistent_levels,
    raw_worlds,
)
from residua.decide.checks import check_rate
from residua.decide.exceedance_tail import without_steps
from residua.decide.fault_free import FaultFree, Moments, check_enough
from residua.decide.row_norms import row_norms
from residua.decide.test import FaultFreeRun
from residua.decide.treatment import ResidualFit, Treated, fit_parts, inverse_of, whitened_part
from residua.decide.whitened_norm import Fitted, NormSettings, NormTest, fit_moments, with_threshold
from residua.decide.whitening import whitening_matrix
from residua.decide.window import empty_window, moving_sum
from residua.errors import DataError
from residua.tolerances import SIGNAL_ROUNDING, TINY


@dataclass(frozen=True, eq=False)
class NormFit:
    """Whitening of the sums of each part, with the residual model that it is from.

    Attributes
    ----------
    fit : ResidualFit
    made : list of Treated
    whitening : list of ndarray
        Of sums over the window, divided by its root.
    """

    fit: ResidualFit
    made: list[Treated]
    whitening: list[NDArray[np.float64]]


def fit_norms(
    settings: NormSettings,
    run: FaultFreeRun,
    rows: Sequence[Sequence[int]],
    rate: float,
    covariances: Sequence[NDArray[np.float64] | None],
) -> list[NormTest] | None:
    """Fit mean, covariance and threshold of the norm of each part, which together keep a rate.

    ``None`` where thresholds are to be read off the data, from :func:`moments_of`: order statistics, residuals without
    noise, whose threshold is at the level of rounding, and fewer than ten independent rows to each residual, when a
    refit says little of other fits.

    Parameters
    ----------
    settings : NormSettings
    run : FaultFreeRun
    rows : sequence of sequence of int
        Residual numbers of each part.
    rate : float
        Fraction of samples in which any part is in alarm.
    covariances : sequence of ndarray or None
        Of sums over the window, by the noise model of the plant.
    """
    worth = _worth(settings, run, rows)
    if settings.source != "auto" or worth < LEAST_ROWS:
        return None
    known = [_known(settings, len(one), covariance) for one, covariance in zip(rows, covariances, strict=True)]
    own = _fitted(settings.window, run, rows, known)
    release = settings.release or settings.persistence
    tests = [
        NormTest(made.parts["center"], W, np.inf, settings.persistence, release, settings.window, "")
        for made, W in zip(own.made, own.whitening, strict=True)
    ]
    tests = [
        test if fixed is not None else replace(test, shrinkage=float(made.shrinkage))
        for test, made, fixed in zip(tests, own.made, known, strict=True)
    ]
    if settings.threshold is not None:
        basis = "threshold given, mean and covariance fitted"
        return [replace(test, threshold=settings.threshold, basis=basis) for test in tests]
    norms = _world_norms(settings, own, known)
    levels = persistent_levels(np.concatenate(norms), settings.persistence, release)[:, SETTLING:]
    levels = levels.reshape(len(rows), -1, levels.shape[1])
    units = [max(float(np.quantile(one, 1 - rate)), TINY) for one in levels]
    together = (levels / np.reshape(units, (-1, 1, 1))).max(axis=0)
    data = _held_out_levels(settings, run, rows, known, units)
    found = calibrated(together, data, rate, own.fit.model.rows, worth=worth)
    return [
        _with_threshold(test, made, unit, found, _half_a_step(test, run, one))
        for test, made, unit, one in zip(tests, own.made, units, rows, strict=True)
    ]


def _half_a_step(test: NormTest, run: FaultFreeRun, rows: Sequence[int]) -> float:
    """Return half the step in which the norm comes, as that of a coarse sensor does; 0 if it does not."""
    data = FaultFree(run.residuals[:, list(rows)], run.usable, test.window, run.seams)
    return without_steps(data.statistic(Moments(test.center, test.whitening))[data.full])[1]


def _known(settings: NormSettings, k: int, covariance: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
    """Return the whitening that does not come from data; ``None`` if it does."""
    if settings.whiten == "model" and covariance is not None:
        return whitening_matrix(covariance)
    return np.eye(k) if settings.whiten == "none" else None


def whitening_of_sums(
    settings: NormSettings, run: FaultFreeRun, covariance: NDArray[np.float64] | None
) -> NDArray[np.float64]:
    """Return the whitening of sums of all residuals together; the identity if they hold no noise."""
    rows = [range(run.residuals.shape[1])]
    if _worth(settings, run, rows) < LEAST_ROWS:
        return moments_of(settings, run, rows, [covariance])[0].test.whitening
    return _fitted(settings.window, run, rows, [_known(settings, len(rows[0]), covariance)]).whitening[0]


def _worth(settings: NormSettings, run: FaultFreeRun, rows: Sequence[Sequence[int]]) -> float:
    """Return the number of independent rows to each residual, of the part that has the fewest; 0 without noise.

    Raises
    ------
    DataError
        If there are too few samples for any fit.
    """
    least = np.inf
    for one in rows:
        data = FaultFree(run.residuals[:, list(one)], run.usable, settings.window, run.seams)
        check_enough(int(run.usable.sum()), len(one), settings.window)
        if not data.full.any():
            longest = max(int(run.usable[part].sum()) for part in data.parts)
            raise DataError(
                f"no recording has as many usable samples as the window of {settings.window}: the longest has "
                f"{longest}; take a shorter window, or longer recordings"
            )
        is_still = data.spread <= SIGNAL_ROUNDING * run.signal_size(one)
        own = 0.0 if is_still else float(run.usable.sum()) / data.worth[0] / max(data.moving, 1)
        least = min(least, own)
    return least


def moments_of(
    settings: NormSettings,
    run: FaultFreeRun,
    rows: Sequence[Sequence[int]],
    covariances: Sequence[NDArray[np.float64] | None],
) -> list[Fitted]:
    """Return mean and covariance of the sums of each part, with its cross-fitted statistic."""
    return [
        fit_moments(
            settings,
            run.residuals[:, list(one)],
            run.usable,
            covariance=covariance,
            signal_size=run.signal_size(one),
            seams=run.seams,
        )
        for one, covariance in zip(rows, covariances, strict=True)
    ]


def _with_threshold(test: NormTest, made: Treated, unit: float, found: Calibration, half: float) -> NormTest:
    """Return a test with its threshold, and the basis of that.

    The model is smooth: of values in steps no more than the rate is over a threshold that lies half a step higher.
    """
    notes = [note for note in made.notes if not note.startswith("correlated in time:")]
    order = len(made.parts["coefficients"])
    if order:
        notes.append(f"with a memory of {order} samples")
    basis = "; ".join([str(found), *notes])
    return replace(test, threshold=found.threshold * unit + half, basis=basis, promised=float(found.promised))


def _fitted(
    window: int, run: FaultFreeRun, rows: Sequence[Sequence[int]], known: Sequence[NDArray[np.float64] | None]
) -> NormFit:
    """Fit the residual model, and the whitening of sums that it implies."""
    made = [whitened_part("auto", run, one) for one in rows]
    whitening = []
    for one, mine, fixed in zip(made, rows, known, strict=True):
        W = one.parts["whitening"]
        if fixed is None and window > 1:
            A = one.parts["coefficients"]
            data = FaultFree(run.residuals[:, list(mine)], run.usable, 1, run.seams)
            q = np.where(run.usable[:, None], (data.residuals - one.parts["center"]) @ W, 0.0)
            products = np.array([np.eye(len(W)), *(_product(q, data, lag) for lag in range(1, len(A) + 1))])
            W = W @ inverse_root(sum_covariance(products, A, window))
        whitening.append(W if fixed is None else fixed)
    return NormFit(fit_parts(made, rows, run), made, whitening)


def _product(q: NDArray[np.float64], data: FaultFree, lag: int) -> NDArray[np.float64]:
    """Return the covariance of samples so far apart, drawn to zero as one over all samples is."""
    total, pairs = np.zeros((q.shape[1], q.shape[1])), 0
    for part in data.parts:
        here, there = q[part][: max(part.stop - part.start - lag, 0)], q[part][lag:]
        total += here.T @ there
        pairs += int(np.count_nonzero(data.usable[part][: len(here)] & data.usable[part][lag:]))
    count = int(data.usable.sum())
    return total / max(pairs, 1) * max(count - lag, 0) / count


def sum_covariance(products: NDArray[np.float64], A: NDArray[np.float64], window: int) -> NDArray[np.float64]:
    r"""Return the covariance of sums over a window, divided by its length, that an autoregression implies.

    .. math:: \Sigma_N = \Gamma_0 + \sum_{j=1}^{N-1} \left(1 - \frac jN\right) (\Gamma_j + \Gamma_j^T), \qquad
       \Gamma_j = \sum_i \Gamma_{j-i} A_i

    Parameters
    ----------
    products : ndarray, shape (p + 1, ..., k, k)
        Covariances of samples 0 to p apart, the earlier one first.
    A : ndarray, shape (..., p, k, k)
    window : int
    """
    order = A.shape[-3]
    if not order or window == 1:
        return products[0]
    where = (A != 0).any(axis=tuple(range(A.ndim - 2))) | np.eye(A.shape[-1], dtype=bool)
    last = [one * where for one in products[1:]]
    total = products[0].copy()
    before = [products[0] * where, *last]
    for j in range(1, window):
        if j > order:
            new = sum(before[-i] @ A[..., i - 1, :, :] for i in range(1, order + 1))
            before = [*before[1:], new]
            now = new
        else:
            now = last[j - 1]
        total += (1 - j / window) * (now + np.swapaxes(now, -1, -2))
    return total


def _world_norms(
    settings: NormSettings, own: NormFit, known: Sequence[NDArray[np.float64] | None]
) -> list[NDArray[np.float64]]:
    """Return the norms of each part on new rows of worlds, each whitened by a fit to its own rows."""
    window, model = settings.window, own.fit.model
    raw = raw_worlds(model, settling=SETTLING + window + settings.persistence)
    q, rows, shrink = raw.q, raw.rows, raw.shrink
    new = q[:, rows:]
    sums = np.cumsum(new, axis=1) if window > 1 else new
    if window > 1:
        sums = (sums[:, window:] - sums[:, :-window]) / np.sqrt(window)
    out = []
    for part, one, fixed in zip(own.fit.columns, own.made, known, strict=True):
        if fixed is not None:
            size = inverse_root(_products(q[..., part], 0)[0].mean(axis=0))  # longer memory has made it larger
            out.append(row_norms(sums[..., part] @ (size @ inverse_of(one.parts["whitening"]) @ fixed)))
            continue
        A, fitted = raw.coefficients[:, part, part], raw.fitted[:, :, part, part]
        used = len(one.parts["coefficients"])
        A, fitted = A[:used], fitted[:, :used]
        theirs, everything = _products(q[:, :rows, part], used), _products(q[..., part], used).mean(axis=1)
        truth = sum_covariance(everything, A, window)
        if one.shrinkage:
            theirs[0] = _shrunk(theirs[0], one)
            truth = sum_covariance(np.concatenate([_shrunk(everything[:1], one), everything[1:]]), A, window)
        whole = truth + shrink * (sum_covariance(theirs, fitted, window) - truth)
        out.append(row_norms(sums[..., part] @ inverse_root(whole)))
    return out


def _products(q: NDArray[np.float64], order: int) -> NDArray[np.float64]:
    """Return the covariances of samples 0 to some apart in each world."""
    time = q.shape[1]
    return np.array([np.swapaxes(q[:, : time - lag], 1, 2) @ q[:, lag:] / time for lag in range(order + 1)])


def _shrunk(covariances: NDArray[np.float64], made: Treated) -> NDArray[np.float64]:
    """Return covariances of worlds drawn towards uncorrelated residuals, as far as that of the data was."""
    W = made.parts["whitening"]
    W = W / np.sqrt(np.sum(W**2, axis=1, keepdims=True))  # units of residuals do not matter here
    raw = np.linalg.pinv(W)
    plain = raw.T @ covariances @ raw
    kept = made.shrinkage * np.eye(len(W)) + (1 - made.shrinkage)
    return W.T @ (plain * kept) @ W


def _held_out_levels(
    settings: NormSettings,
    run: FaultFreeRun,
    rows: Sequence[Sequence[int]],
    known: Sequence[NDArray[np.float64] | None],
    units: Sequence[float],
) -> NDArray[np.float64]:
    """Return the largest level of any part, in units of its own, for each quarter by a fit to the others."""
    out, window, release = [], settings.window, settings.release or settings.persistence
    for others, mine in held_out(run):
        try:
            fit = _fitted(window, others, rows, known)
        except DataError:  # too few samples remain for a fit
            return np.zeros(0)
        for part in FaultFree(mine.residuals, mine.usable, window, mine.seams).parts:
            usable = mine.usable[part]
            largest = None
            for made, W, which, unit in zip(fit.made, fit.whitening, rows, units, strict=True):
                x = (mine.residuals[part][usable][:, list(which)] - made.parts["center"]) @ W
                sums = moving_sum(x[None], empty_window(1, window, x.shape[1]), np.ones((1, len(x)), dtype=bool))[0][0]
                levels = persistent_levels(row_norms(sums) / np.sqrt(window) / unit, settings.persistence, release)
                largest = levels if largest is None else np.maximum(largest, levels)
            assert largest is not None  # a generator has at least one residual
            out.append(largest[window + settings.persistence - 2 :])
    return np.concatenate(out) if out else np.zeros(0)


def fit_norm_test(
    settings: NormSettings,
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    *,
    false_alarm_rate: float,
    covariance: NDArray | None,
    signal_size: float,
    seams: Sequence[int] = (),
) -> NormTest:
    """Fit mean, covariance and threshold to fault-free residuals; see :func:`fit_norms`.

    Parameters
    ----------
    settings : NormSettings
    residuals : ndarray, shape (time, k)
    usable : ndarray of bool, shape (time,)
    false_alarm_rate : float
    covariance : ndarray or None
        From the plant's noise model, of sums over the window.
    signal_size : float
        Size of the signals that the residual is the difference of; residuals below 1e-12 of it are rounding.
    seams : sequence of int
        Where ``residuals`` are those of several recordings in a row: the first sample of each further one. No window,
        run or correlation reaches across.

    Returns
    -------
    NormTest
    """
    check_rate(false_alarm_rate)
    run = FaultFreeRun(residuals, usable, tuple(seams), np.full(residuals.shape[1], signal_size))
    return fit_norm(settings, run, false_alarm_rate, covariance)


def fit_norm(
    settings: NormSettings, run: FaultFreeRun, rate: float, covariance: NDArray[np.float64] | None
) -> NormTest:
    """Return the test of all residuals together; see :func:`fit_norms`."""
    rows = [range(run.residuals.shape[1])]
    tests = fit_norms(settings, run, rows, rate, [covariance])
    return with_threshold(moments_of(settings, run, rows, [covariance])[0], rate) if tests is None else tests[0]


__all__ = ["fit_norm", "fit_norm_test", "fit_norms", "moments_of", "sum_covariance", "whitening_of_sums"]
