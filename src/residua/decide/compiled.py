"""Descriptions of a test and an isolation for the fused loop of a monitor, for kinds that are also written in C."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

#: Statistics in C, as :file:`_judging.h` numbers them; that of parts is in :file:`_members.h`.
STATISTICS = (
    "norm",
    "page",
    "crosier",
    "pignatiello-runger",
    "ewma",
    "chi-squared",
    "glr",
    "directed glr",
    "parts",
    "means",
)


@dataclass(frozen=True, eq=False)
class CompiledTest:
    """A test as the fused loop runs it, equal to :meth:`residua.decide.test.ResidualTest.run` to the last bit.

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
        Of sequential tests.
    coefficients, rewhitening, knots, scores : ndarray or None
        Treatment that makes a residual white and Gaussian.
    along : ndarray, shape (k, directions), or None
        Of a likelihood ratio along directions.
    sizes : ndarray of int, shape (parts,), or None
        How many whitened residuals each part has that is tested by itself, such as a member of a bank.
    limits : ndarray, shape (parts,), or None
        The threshold of each.
    weights, scaling : ndarray or None
        Of a bank of means, as of ``MultiscaleEWMATest``.
    lengths : tuple of ndarray
        Its ``clips``, ``fulls`` and ``releases``.
    joint : ndarray, shape (residuals, k), or None
        A whitening of all, in which the direction is judged; the other one when omitted.
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
    sizes: NDArray[np.int64] | None = None
    limits: NDArray[np.float64] | None = None
    joint: NDArray[np.float64] | None = None
    weights: NDArray[np.float64] | None = None
    scaling: NDArray[np.float64] | None = None
    lengths: tuple[NDArray[np.float64], ...] = ()


@dataclass(frozen=True, eq=False)
class CompiledIsolation:
    """An isolation by direction as the fused loop runs it; without bases for no isolation.

    Attributes
    ----------
    window : int
        0 for the mean of :mod:`residua.decide.directional`.
    bases : tuple of ndarray, shape (k, dimension)
    clear : float
        The square of the length of such a mean that is clear of noise.
    """

    window: int = 1
    bases: tuple[NDArray[np.float64], ...] = field(default=())
    clear: float = 0.0


@dataclass(frozen=True, eq=False)
class CompiledCodes:
    """An isolation by code as the fused loop runs it, for a test of parts.

    Attributes
    ----------
    window : int
    share : float
        Of the samples of the member that was in alarm the longest, from which on another counts as fired.
    codes : ndarray of bool, shape (members, groups)
    at_once : bool
        Whether the members in alarm count as fired, whatever the window.
    """

    window: int
    share: float
    codes: NDArray[np.bool_]
    at_once: bool = False


__all__ = ["STATISTICS", "CompiledCodes", "CompiledIsolation", "CompiledTest"]
