"""Specification of a running monitor, and the state of its filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.decide.isolation import Isolation
from residua.decide.test import ResidualTest
from residua.monitor.partial_update import PartialUpdate
from residua.monitor.starting import StartFit


@dataclass(frozen=True, eq=False)
class Specification:
    """Constant parameters of a running monitor.

    Attributes
    ----------
    A, B, C, D : ndarray
        Of the sampled generator, driven by ``[u, y]`` as deviations.
    start : ndarray, shape (states, channels)
        Maps a sample to the filter state that it would settle to.
    offset : ndarray, shape (channels,)
        Operating point.
    test : ResidualTest
        Test that turns the residual into a statistic and an alarm.
    isolation : Isolation
        Isolation that names the fault.
    settle : int
        Samples after a start, or after a held value, in which nothing is decided.
    max_hold : int
        Longest gap over which missing values are held; after a longer one the filter restarts.
    plausible : ndarray, shape (channels, 2)
        Smallest and largest deviation of each channel from its operating point that is taken for a value; any other is
        missing.
    first : StartFit or None
        Estimator of a start from the first residuals; ``None`` if a start is from rest.
    partial : PartialUpdate or None
        Data of a Kalman filter for missing outputs; ``None`` for any other generator.
    """

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]
    start: NDArray[np.float64]
    offset: NDArray[np.float64]
    test: ResidualTest
    isolation: Isolation
    settle: int
    max_hold: int
    plausible: NDArray[np.float64]
    first: StartFit | None
    partial: PartialUpdate | None

    @property
    def held(self) -> int:
        """Number of channels whose missing values are held: a Kalman filter leaves missing outputs out instead."""
        return self.B.shape[1] if self.partial is None else self.partial.B.shape[1]

    @property
    def members(self) -> tuple[str, ...]:
        """Names of the parts with their own alarm: members of a bank, or groups of residuals."""
        return self.test.part_names


@dataclass(frozen=True, eq=False)
class FilterState:
    """State of the filter of a running monitor; every array has one row per plant.

    Counters of 32 bits stop at :data:`residua.decide.persistence.LAST_COUNT`. Those of :data:`SELDOM` are zero as a
    rule, and take no memory for plants all of which have zeros.

    Attributes
    ----------
    x : ndarray, shape (plants, states)
        Filter state, in its own units: 8 bytes for each.
    held : ndarray, shape (plants, channels)
        Last value of each channel as a deviation, in plant units: 8 bytes for each. Of a Kalman filter that goes on
        without missing outputs, those of the inputs alone.
    gap : ndarray of int32
        Incomplete samples in a row, or of such a Kalman filter those without any output that it can use.
    running : ndarray of bool
        Whether the filter has been started.
    age : ndarray of int32
        Samples since its start or the last held value.
    resets, broken : ndarray of int
        Restarts after long gaps, and of a filter whose state overflowed.
    starting : ndarray of bool
        Whether the start is still to be estimated.
    start_sums : ndarray, shape (plants, states)
        Sums of residuals for the estimate of the start; zero if none is to be estimated.
    moved : ndarray
        How far an estimate of the start moved a residual, in units of the threshold, at most; zero where it is less
        than :data:`residua.monitor.starting.MOVED_FROM`.
    apart : ndarray of bool
        Whether a Kalman filter is off its stationary one, since outputs were missing.
    spread : ndarray, shape (plants, states, states)
        Its covariance then, zero for the stationary one.
    bent : ndarray, shape (plants, ages + 1, faults, states)
        How far its errors by faults are off.
    """

    x: NDArray[np.float64]
    held: NDArray[np.float64]
    gap: NDArray[np.int32]
    running: NDArray[np.bool_]
    age: NDArray[np.int32]
    resets: NDArray[np.int64]
    broken: NDArray[np.int64]
    starting: NDArray[np.bool_]
    start_sums: NDArray[np.float64]
    moved: NDArray[np.float64]
    apart: NDArray[np.bool_]
    spread: NDArray[np.float64]
    bent: NDArray[np.float64]
