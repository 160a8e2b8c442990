"""Probability of detection against the size of a fault, in the terms of non-destructive testing: a90 and a90/95."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from residua.tolerances import ROUNDING, SAME
from residua.words import number

#: The share of a90.
NINETY = 0.9
#: Deviations of a one-sided bound of 95 % confidence.
_ONE_SIDED = NormalDist().inv_cdf(0.95)
#: Steps of Newton's method, and the largest argument of the logistic function that is told from certainty.
_STEPS, _MOST = 100, 500.0


@dataclass(frozen=True, eq=False)
class DetectionProbability:
    r"""Probability of detection by the size of a fault, fitted to runs of several sizes.

    .. math:: P(a) = \frac{1}{1 + e^{-(\beta_0 + \beta_1 \ln a)}}

    by maximum likelihood, with the covariance of :math:`\beta` from Fisher's information.

    Attributes
    ----------
    fault, shape : str
    sizes : ndarray
        Magnitudes, in the unit of the fault.
    runs, detected : ndarray of int
        By size.
    beta : ndarray, shape (2,), or None
        ``None`` where it cannot be fitted.
    covariance : ndarray, shape (2, 2), or None
    a90 : float
        Size with a probability of 0.9; NaN without a fit.
    a90_95 : float
        Size from which on the lower 95 % confidence bound of the probability is over 0.9; infinite if it never is.
    reason : str
        Reason for having no fit, or other cautions; else empty.

    References
    ----------
    MIL-HDBK-1823A (2009), Nondestructive evaluation system reliability assessment, appendix G (hit or miss data).
    """

    fault: str
    shape: str
    sizes: NDArray[np.float64]
    runs: NDArray[np.int64]
    detected: NDArray[np.int64]
    beta: NDArray[np.float64] | None
    covariance: NDArray[np.float64] | None
    a90: float
    a90_95: float
    reason: str = ""

    def probability(self, size: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the fitted probability at sizes, and its lower 95 % confidence bound."""
        assert self.beta is not None
        assert self.covariance is not None
        rows = np.column_stack([np.ones_like(size), np.log(np.abs(size))])
        middle = rows @ self.beta
        spread = np.sqrt(np.einsum("ij,jk,ik->i", rows, self.covariance, rows))
        return _logistic(middle), _logistic(middle - _ONE_SIDED * spread)

    def __str__(self) -> str:
        if self.beta is None:
            return f"{self.fault} ({self.shape}): {self.reason}"
        more = f"; {self.reason}" if self.reason else ""
        return f"{self.fault} ({self.shape}): a90 = {number(self.a90, 3)}, a90/95 = {number(self.a90_95, 3)}{more}"


def detection_probability(
    fault: str, shape: str, sizes: NDArray[np.float64], runs: NDArray[np.int64], detected: NDArray[np.int64]
) -> DetectionProbability:
    """Return the fit to counts of detections by size, or the reason for none."""
    order = np.argsort(np.abs(sizes), kind="stable")
    a, n, k = np.abs(sizes)[order], runs[order], detected[order]
    missing = (fault, shape, a, n, k, None, None, float("nan"), float("nan"))
    reason = _why_not(a, n, k)
    if reason:
        return DetectionProbability(*missing, reason)
    x = np.log(a)
    centre, spread = float(x.mean()), float(np.ptp(x))
    fitted = _fit((x - centre) / spread, n, k)
    if fitted is None:
        return DetectionProbability(*missing, "the likelihood has no largest value: add sizes between these")
    beta, covariance = fitted
    if not beta[1] > 0:
        return DetectionProbability(
            *missing, "larger faults are not detected more often: no size has a probability of 0.9"
        )
    wanted = float(np.log(NINETY / (1 - NINETY)))
    a90 = float(np.exp(centre + spread * (wanted - beta[0]) / beta[1]))
    bound = _bound(beta, covariance, wanted)
    change = np.array([[1.0, -centre / spread], [0.0, 1 / spread]])
    reason = "" if a[0] <= a90 <= a[-1] else "a90 is outside of the sizes that were run: add some there"
    return DetectionProbability(
        fault,
        shape,
        a,
        n,
        k,
        change @ beta,
        change @ covariance @ change.T,
        a90,
        float(np.exp(centre + spread * bound)) if np.isfinite(bound) else float("inf"),
        reason,
    )


def _why_not(a: NDArray[np.float64], n: NDArray[np.int64], k: NDArray[np.int64]) -> str:
    """Return the reason for having no fit; empty if there is one."""
    if len(np.unique(a)) < 2:
        return "needs two sizes or more: Scenario(..., size=[...])"
    if (k == n).all():
        return f"every run was detected, from size {a[0]:.3g} on: add smaller ones"
    if not k.any():
        return f"no run was detected, up to size {a[-1]:.3g}: add larger ones"
    silent, seen = a[k < n].max(), a[k > 0].min()
    if silent < seen:
        return (
            f"all runs were missed up to size {silent:.3g} and all detected from {seen:.3g} on: a90 lies between, add "
            "sizes there"
        )
    if silent == seen:
        return (
            f"only size {seen:.3g} was detected in some runs and missed in others: add sizes near to it, by which a "
            "slope can be estimated"
        )
    return ""


def _fit(
    x: NDArray[np.float64], n: NDArray[np.int64], k: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return the most likely coefficients and their covariance (Newton's method), or ``None``."""
    rows, beta = np.column_stack([np.ones_like(x), x]), np.zeros(2)

    def likelihood(b: NDArray[np.float64]) -> float:
        eta = rows @ b
        return float(k @ eta - n @ np.logaddexp(0.0, eta))

    best = likelihood(beta)
    for _ in range(_STEPS):
        p = _logistic(rows @ beta)
        information = (rows * (n * p * (1 - p))[:, None]).T @ rows
        determinant = float(np.linalg.det(information))
        if not determinant > 0 or np.abs(rows @ beta).max() > _MOST:
            return None
        step, length = np.linalg.solve(information, rows.T @ (k - n * p)), 1.0
        while likelihood(beta + length * step) < best - ROUNDING * abs(best) and length > SAME:
            length /= 2
        beta = beta + length * step
        best = likelihood(beta)
        if np.abs(step).max() <= SAME * max(1.0, np.abs(beta).max()):
            return beta, np.asarray(np.linalg.inv(information), dtype=np.float64)
    return None


def _bound(beta: NDArray[np.float64], covariance: NDArray[np.float64], wanted: float) -> float:
    """Return the size at which the lower confidence bound of the linear predictor reaches a value; infinite if never.

    ``beta0 + beta1 x - z sqrt(v00 + 2 v01 x + v11 x^2) = wanted``, the larger root.
    """
    z = _ONE_SIDED
    (v00, v01), (_, v11) = covariance
    b0, b1 = beta[0] - wanted, beta[1]
    a, b, c = b1**2 - z**2 * v11, 2 * (b0 * b1 - z**2 * v01), b0**2 - z**2 * v00
    inside = b**2 - 4 * a * c
    if not a > 0 or inside < 0:
        return float("inf")
    return float((-b + np.sqrt(inside)) / (2 * a))


def _logistic(eta: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.exp(-np.logaddexp(0.0, -eta))
