"""Fault-free residuals: their windowed sums, their moments, and cross-fitted statistics."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from residua.decide.dependence import CUT, correlation_times, mean_autocorrelation
from residua.decide.whitening import moving_directions, whitening_matrix
from residua.decide.window import empty_window, moving_sum
from residua.errors import DataError
from residua.linear.subspaces.whitening import VARIANCE_FLOOR
from residua.tolerances import ROUNDING
from residua.words import counted

#: With that many independent samples to each residual a covariance counts as known, and is left as it is.
KNOWN = 10.0
#: Stretches of time that are held out in turn; fewer where moments are known well anyway.
FOLDS, FEW_FOLDS = 16, 4
#: Independent samples to a residual from which on few stretches do.
_PLENTY = 20 * KNOWN


def oracle_approximating_intensity(correlation: NDArray[np.float64], samples: float) -> float:
    r"""Return the shrinkage of a sample correlation matrix towards the identity: between 0 and 1.

    .. math::

       \varrho = \min\left(1, \frac{(1 - 2/p)\,\mathrm{tr}(S^2) + \mathrm{tr}^2(S)}
       {(n + 1 - 2/p)\,\left(\mathrm{tr}(S^2) - \mathrm{tr}^2(S)/p\right)}\right)

    of ``p`` Gaussian residuals and ``n`` independent samples, the least mean square error that is attained without
    knowing the true covariance. Of dependent samples, ``n`` is the number of independent ones that they are worth.

    References
    ----------
    Chen, Wiesel, Eldar and Hero (2010), IEEE Transactions on Signal Processing 58(10), 5016-5029, eq. (23).

    Examples
    --------
    >>> import numpy as np
    >>> round(oracle_approximating_intensity(np.array([[1.0, 0.5], [0.5, 1.0]]), 20), 3)
    0.4
    """
    p = len(correlation)
    if p < 2:
        return 0.0
    squares, square = float(np.sum(correlation**2)), float(np.trace(correlation)) ** 2
    apart = squares - square / p
    above = (1 - 2 / p) * squares + square
    below = (max(samples, 1.0) + 1 - 2 / p) * apart
    return 1.0 if above >= below else above / below


def shrunk(covariance: NDArray[np.float64], samples: float) -> tuple[NDArray[np.float64], float]:
    """Return a covariance shrunk for its number of independent samples, and the size of the change.

    Where they are fewer than ten to a residual the correlations are drawn towards zero
    (:func:`oracle_approximating_intensity`); the variances stay, so that the outcome does not depend on units.

    Parameters
    ----------
    covariance : ndarray, shape (k, k)
    samples : float

    Returns
    -------
    covariance : ndarray, shape (k, k)
    intensity : float
    """
    moving = np.flatnonzero(np.diag(covariance) > 0)
    if len(moving) < 2 or samples >= KNOWN * len(moving):
        return covariance, 0.0
    spread = np.sqrt(np.diag(covariance)[moving])
    part = covariance[np.ix_(moving, moving)] / np.outer(spread, spread)
    intensity = oracle_approximating_intensity(part, samples)
    off = covariance * (1 - intensity)
    np.fill_diagonal(off, np.diag(covariance))
    return off, intensity


@dataclass(frozen=True, eq=False)
class Moments:
    """Mean and covariance of residuals, as an offset to subtract and a matrix to multiply by.

    Attributes
    ----------
    center : ndarray, shape (k,)
    whitening : ndarray, shape (k, k)
    intensity : float
        How far the covariance was drawn towards a simpler one; 0 if the data sufficed.
    """

    center: NDArray[np.float64]
    whitening: NDArray[np.float64]
    intensity: float = 0.0


@dataclass(frozen=True, eq=False)
class FaultFree:
    """Fault-free residuals of one recording, or of several in a row.

    Attributes
    ----------
    residuals : ndarray, shape (time, k)
    usable : ndarray of bool, shape (time,)
    window : int
        Samples over which the test sums.
    seams : tuple of int
        The first sample of each further recording: nothing is summed, correlated or counted across it.
    """

    residuals: NDArray[np.float64]
    usable: NDArray[np.bool_]
    window: int = 1
    seams: tuple[int, ...] = ()

    @cached_property
    def parts(self) -> tuple[slice, ...]:
        """The recordings."""
        edges = sorted({0, len(self.usable), *(int(s) for s in self.seams if 0 < s < len(self.usable))})
        return tuple(slice(a, b) for a, b in pairwise(edges))

    @cached_property
    def middle(self) -> NDArray[np.float64]:
        """The mean of all usable residuals."""
        return self.residuals[self.usable].mean(axis=0)

    @cached_property
    def deviations(self) -> NDArray[np.float64]:
        """Residuals less their mean, zero where unusable and where a residual is constant: its mean is rounded."""
        out = np.where(self.usable[:, None], self.residuals - self.middle, 0.0)
        rows = self.residuals[self.usable]
        if len(rows):
            out[:, np.ptp(rows, axis=0) <= ROUNDING * np.abs(self.middle)] = 0.0
        return out

    @cached_property
    def moving(self) -> int:
        """Number of independent directions in which the residuals move."""
        rows = self.deviations[self.usable]
        return moving_directions(rows.T @ rows / max(1, len(rows)))

    @property
    def spread(self) -> float:
        """The root of the trace of the covariance of sums over the window, divided by its length."""
        rows = self.sums[self.full] / np.sqrt(self.window)
        return float(np.sqrt(np.sum(rows**2) / max(1, len(rows))))

    @cached_property
    def sums(self) -> NDArray[np.float64]:
        """Sums of the deviations over the window."""
        return self._summed(self.deviations, self.usable)

    @cached_property
    def weights(self) -> NDArray[np.float64]:
        """Number of usable samples in each of these sums, as a column."""
        return self._summed(self.usable[:, None].astype(float), self.usable)

    @cached_property
    def without_holes(self) -> NDArray[np.float64]:
        r"""Factors that scale each sum to its size without gaps, as a column.

        .. math:: f_t^2 = \frac{\sum_{i,j} \varrho(i - j)}{\sum_{i,j} \varrho(\tau_i - \tau_j)}

        over the samples :math:`\tau` of a window and over as many without holes: correlated samples that lie further
        apart are less alike, and their sum varies less. Exactly one where there are none, and no less elsewhere: other
        data may have as many holes.
        """
        out, N = np.ones((len(self.usable), 1)), self.window
        if N == 1 or not self._has_holes:
            return out
        share = float(np.mean(self.usable))
        last = int(np.ceil(CUT * self._correlation_time / share)) + 1
        rho = np.append(mean_autocorrelation(self.deviations, self.usable, self.parts, last), 0.0)  # and none beyond
        distances = np.minimum(np.arange(1, N), last + 1)
        whole = N + 2 * float(np.sum((N - np.arange(1, N)) * rho[distances]))
        for part in self.parts:
            rows = np.flatnonzero(self.usable[part]) + part.start
            ends = np.arange(N - 1, len(rows))
            thinned = np.full(len(ends), float(N))
            for d in range(1, N) if len(ends) else ():
                pairs = np.cumsum(np.append(0.0, rho[np.minimum(rows[d:] - rows[:-d], last + 1)]))
                thinned += 2 * (pairs[ends - d + 1] - pairs[ends - N + 1])
            there = (rows[ends] - rows[ends - N + 1] > N - 1) & (thinned > 0) & (whole > 0)
            out[rows[ends[there]], 0] = np.sqrt(np.clip(whole / thinned[there], 1.0, N))
        return out

    @property
    def _has_holes(self) -> bool:
        rows = [np.flatnonzero(self.usable[part]) for part in self.parts]
        return any(len(one) and one[-1] - one[0] + 1 > len(one) for one in rows)

    @cached_property
    def full(self) -> NDArray[np.bool_]:
        """Mask of usable samples preceded by a whole window in the same recording."""
        seen = np.concatenate([np.cumsum(self.usable[part]) for part in self.parts])
        return self.usable & (seen >= self.window)

    def _summed(self, columns: NDArray[np.float64], judged: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return sums over the last judged samples, as in a test; zero at others."""
        if self.window == 1:
            return columns
        empty = empty_window(1, self.window, columns.shape[1])
        sums = [moving_sum(columns[None, part], empty, judged[None, part])[0][0] for part in self.parts]
        return np.concatenate(sums)

    def usable_samples_away(self, place: int, count: int, part: slice) -> int:
        """Return the place so many usable samples of a recording away, backwards if negative."""
        rows = np.flatnonzero(self.usable[part]) + part.start
        index = int(np.searchsorted(rows, place)) + count
        return part.start if index < 0 else part.stop if index >= len(rows) else int(rows[index])

    # ------------------------------------------------------------------ moments

    def moments(
        self,
        kept: NDArray[np.bool_] | None = None,
        summed: NDArray[np.bool_] | None = None,
        *,
        whitening: NDArray[np.float64] | None = None,
    ) -> Moments:
        """Return the moments of the samples that are kept, with the covariance of sums over windows within them.

        The covariance of sums is estimated in units in which single samples are white: where few windows fit into the
        data it is drawn towards that of independent samples.

        Parameters
        ----------
        kept, summed : ndarray of bool, shape (time,), optional
            Single samples, and last samples of windows; all usable and full ones when omitted.
        whitening : ndarray, shape (k, k), optional
            Where this is known, only the mean is estimated.
        """
        kept = self.usable if kept is None else kept
        summed = self.full if summed is None else summed
        rows = self.deviations[kept]
        center = rows.mean(axis=0)
        if whitening is not None:
            return Moments(self.middle + center, whitening)
        centred = rows - center
        covariance = centred.T @ centred / max(1, len(rows) - 1)
        covariance, intensity = shrunk(covariance, len(rows) / self.worth[0])
        first = whitening_matrix(covariance)
        if self.window == 1:
            return Moments(self.middle + center, first, intensity)
        if not summed.any():
            return Moments(self.middle + center, first, 1.0)
        z = (self.sums[summed] - self.window * center) @ first / np.sqrt(self.window) * self.without_holes[summed]
        # Directions that the first whitening raised to its floor never moved: their sums count as those of independent
        # samples do, or the second whitening would take the floor away again.
        raised = 1 - np.sum(first * (covariance @ first), axis=0)
        raised = np.where(raised > VARIANCE_FLOOR, raised, 0.0)
        second, later = shrunk_to_one(z.T @ z / len(z) + np.diag(raised), len(z) / self.worth[1])
        return Moments(self.middle + center, first @ whitening_matrix(second), max(intensity, later))

    @cached_property
    def worth(self) -> tuple[float, float]:
        """Number of samples worth one independent one: for the covariance of residuals, and for that of their sums."""
        single = correlation_times(self.deviations, self.parts, 2)
        if self.window == 1:
            return float(single.mean()), float(single.mean())
        in_time = self._summed(self.deviations, np.ones(len(self.usable), dtype=bool))  # as lags are, missing ones zero
        return float(single.mean()), float(correlation_times(in_time, self.parts, 2).mean())

    @cached_property
    def _correlation_time(self) -> float:
        return float(correlation_times(self.deviations, self.parts).mean())

    @property
    def memory(self) -> int:
        """Lag beyond which residuals are nearly independent."""
        return int(np.ceil(self._correlation_time)) if self._correlation_time > 1.5 else 0

    # ------------------------------------------------------------------ holding out

    def held_out(self) -> Iterator[tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]]:
        """Yield stretches of time with the samples far enough from each: held, kept, summed.

        Between what is held out and what is kept lies a gap of the correlation time, and of the window as well before
        the sums that are kept.
        """
        k = self.residuals.shape[1]
        plenty = self.usable.sum() / max(self.worth) >= _PLENTY * k
        index = np.arange(len(self.usable))
        for start, stop in self._stretches(FEW_FOLDS if plenty else FOLDS):
            near = np.zeros(len(index), dtype=bool)
            reach = np.zeros(len(index), dtype=bool)
            for part in self.parts:
                a, b = max(start, part.start), min(stop, part.stop)
                if a < b:
                    high = min(part.stop, b + self.memory)  # the windows that are held out begin before
                    low = self.usable_samples_away(a - self.memory, 1 - self.window, part)
                    near[low:high] = True
                    reach[low : self.usable_samples_away(high, self.window - 1, part)] = True
            kept = self.usable & ~near
            if kept.any():
                yield (index >= start) & (index < stop), kept, self.full & ~reach

    def _stretches(self, folds: int) -> list[tuple[int, int]]:
        """Return the bounds of stretches of about as many usable samples; at a seam, if one is near."""
        count = np.cumsum(self.usable)
        edges = np.searchsorted(count, np.arange(1, folds) * count[-1] / folds)
        near = len(self.usable) / folds / 3
        for i, edge in enumerate(edges):
            seams = [part.start for part in self.parts[1:] if abs(part.start - edge) <= near]
            if seams:
                edges[i] = min(seams, key=lambda s: abs(s - edge))
        whole = sorted({0, *map(int, edges), len(self.usable)})
        return list(pairwise(whole))

    def statistic(self, moments: Moments, rows: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
        """Return the norms of the whitened sums, as a monitor computes them up to rounding."""
        chosen = slice(None) if rows is None else rows
        sums = self.sums[chosen] - self.weights[chosen] * (moments.center - self.middle)
        norms = np.linalg.norm(sums @ moments.whitening, axis=1) / np.sqrt(self.window)
        return norms * self.without_holes[chosen, 0]

    def scaled(self, moments: Moments, whole: Moments) -> Moments:
        """Return moments in the scale of those of all samples.

        The scale is not held out, since a threshold scales with it.
        """
        inverse = np.linalg.inv(moments.whitening)
        size = np.sqrt(np.sum((inverse @ whole.whitening) ** 2) / len(inverse))
        return Moments(moments.center, moments.whitening * size, moments.intensity)

    def cross_fitted(self, whole: Moments, *, whiten: bool) -> NDArray[np.float64]:
        """Return the statistic of every sample by moments of samples that are far from it."""
        out = self.statistic(whole)
        for held, kept, summed in self.held_out():
            if whiten:
                own = self.scaled(self.moments(kept, summed), whole)
            else:
                own = self.moments(kept, summed, whitening=whole.whitening)
            out[held] = self.statistic(own, held)
        return out


def shrunk_to_one(covariance: NDArray[np.float64], samples: float) -> tuple[NDArray[np.float64], float]:
    """Return a covariance drawn towards a multiple of the identity, variances as well; see :func:`shrunk`."""
    k = len(covariance)
    scale = float(np.trace(covariance)) / k
    if k < 2 or samples >= KNOWN * k or not scale > 0:
        return covariance, 0.0
    intensity = oracle_approximating_intensity(covariance / scale, samples)
    return (1 - intensity) * covariance + intensity * scale * np.eye(k), intensity


def check_enough(samples: int, k: int, window: int) -> None:
    """Raise unless there are enough samples."""
    least = max(30, 2 * window)
    if samples < least:
        raise DataError(
            f"{samples} usable samples are too few to fit {counted(k, 'residual')} with a window of {window}: give at "
            f"least {least} fault-free samples after the filter has settled"
        )


__all__ = ["FaultFree", "Moments", "check_enough"]
