"""What the fused loop of a monitor needs of a test and of an isolation, for those that are written in C too."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

#: Statistics in C, as :file:`_judging.h` numbers them.
STATISTICS = ("norm", "page", "crosier", "pignatiello-runger", "ewma", "chi-squared", "glr", "directed glr")


@dataclass(frozen=True, eq=False)
class CompiledTest:
    """A test as the fused loop runs it, with the same bits as its :meth:`residua.decide.test.ResidualTest.run`.

    Attributes
    ----------
    statistic : str
        One of :data:`STATISTICS`.
    center, whitening : ndarray
    threshold : float
    window, persistence, release : int
        Samples.
    sums : int
        Numbers that the statistic keeps of each plant, but for the window of a norm.
    release_level, allowance, weight, deviation : float
        Of tests that remember.
    coefficients, rewhitening, knots, scores : ndarray or None
        How a residual is made white and Gaussian.
    along : ndarray, shape (k, directions), or None
        Of a likelihood ratio along directions.
    """

    statistic: str
    center: NDArray[np.float64]
    whitening: NDArray[np.float64]
    threshold: float
    window: int = 1
    persistence: int = 1
    release: int = 1
    sums: int = 0
    release_level: float = 0.0
    allowance: float = 0.0
    weight: float = 0.0
    deviation: float = 1.0
    coefficients: NDArray[np.float64] | None = None
    rewhitening: NDArray[np.float64] | None = None
    knots: NDArray[np.float64] | None = None
    scores: NDArray[np.float64] | None = None
    along: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False)
class CompiledIsolation:
    """An isolation by direction as the fused loop runs it; no bases for none.

    Attributes
    ----------
    window : int
    bases : tuple of ndarray, shape (k, dimension)
    """

    window: int = 1
    bases: tuple[NDArray[np.float64], ...] = field(default=())


__all__ = ["STATISTICS", "CompiledIsolation", "CompiledTest"]
