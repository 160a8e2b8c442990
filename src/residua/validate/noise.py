"""Noise of simulated runs: white, coloured, heavy-tailed, or resampled from fault-free residuals."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.decide.checks import check_samples, is_number
from residua.decide.dependence import correlation_times
from residua.errors import DataError, SettingError
from residua.linear.systems.recursion import run_filter
from residua.visible import echo

#: A block of a bootstrap is so many times as long as residuals are correlated.
_TIMES = 5.0


@dataclass(frozen=True)
class NoiseModel(ABC):
    """Noise for the noise inputs of a plant, or a disturbance: zero mean, standard deviation ``size``, seeded.

    Attributes
    ----------
    size : float
        1 for the noise inputs of a plant, whose covariances are as the plant has them.
    """

    size: float

    def __post_init__(self) -> None:
        """Check the size."""
        if not is_number(self.size) or not self.size > 0:
            raise SettingError(f"the size of noise is a positive, finite standard deviation, got {echo(self.size)}")

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> NDArray[np.float64]:
        """Return noise of (samples, channels)."""
        drawn = self.unit(rng, samples, channels)
        return drawn if self.size == 1 else self.size * drawn

    @abstractmethod
    def unit(self, rng: np.random.Generator, samples: int, channels: int) -> NDArray[np.float64]:
        """Return such noise of unit variance."""


@dataclass(frozen=True)
class White(NoiseModel):
    """See :func:`white`."""

    def unit(self, rng: np.random.Generator, samples: int, channels: int) -> NDArray[np.float64]:
        """Return independent Gaussian numbers."""
        return rng.standard_normal((samples, channels))

    def __str__(self) -> str:
        return "white, Gaussian"


@dataclass(frozen=True)
class Coloured(NoiseModel):
    """See :func:`coloured`."""

    correlation: float

    def __post_init__(self) -> None:
        """Check the correlation."""
        super().__post_init__()
        if not is_number(self.correlation) or not -1 < self.correlation < 1:
            raise SettingError(
                f"correlation of a sample with the one before must be over -1 and under 1, got {echo(self.correlation)}"
            )

    def unit(self, rng: np.random.Generator, samples: int, channels: int) -> NDArray[np.float64]:
        """Return autoregressions of first order, stationary from the first sample on."""
        e, one = rng.standard_normal((samples, channels)), np.eye(channels)
        pushed = np.concatenate([e[1:], np.zeros((1, channels))])[None]
        gain = np.sqrt(1 - self.correlation**2) * one
        return run_filter(self.correlation * one, gain, one, 0 * one, e[:1], pushed)[1][0]

    def __str__(self) -> str:
        return f"coloured, first-order autoregression with {self.correlation:g}"


@dataclass(frozen=True)
class HeavyTailed(NoiseModel):
    """See :func:`heavy_tailed`."""

    degrees: float

    def __post_init__(self) -> None:
        """Check the degrees of freedom."""
        super().__post_init__()
        if not is_number(self.degrees) or not self.degrees > 2:
            raise SettingError(
                f"degrees of freedom must be over 2, for there is no variance below, got {echo(self.degrees)}"
            )

    def unit(self, rng: np.random.Generator, samples: int, channels: int) -> NDArray[np.float64]:
        """Return independent numbers of Student's t, with unit variance."""
        return rng.standard_t(self.degrees, (samples, channels)) * np.sqrt((self.degrees - 2) / self.degrees)

    def __str__(self) -> str:
        return f"heavy-tailed, Student t with {self.degrees:g} degrees of freedom"


@dataclass(frozen=True, eq=False)
class Resampled:
    """See :func:`resampled`.

    Attributes
    ----------
    residuals : ndarray, shape (time, k)
        Stretches without a missing value, one after the other.
    starts : ndarray of int
        Where a whole block can begin.
    block : int
        Samples of a block.
    """

    residuals: NDArray[np.float64]
    starts: NDArray[np.int64]
    block: int

    def draw(self, rng: np.random.Generator, samples: int) -> NDArray[np.float64]:
        """Return residuals of (samples, k): blocks drawn evenly, with replacement, one after the other."""
        chosen = self.starts[rng.integers(0, len(self.starts), -(-samples // self.block))]
        return self.residuals[(chosen[:, None] + np.arange(self.block)).ravel()[:samples]]

    def __str__(self) -> str:
        return f"resampled from {len(self.residuals):,} fault-free residuals in blocks of {self.block}"


def white(size: float = 1.0) -> NoiseModel:
    """Return white Gaussian noise.

    Parameters
    ----------
    size : float
        Standard deviation; 1 for the noise inputs of a plant.

    Examples
    --------
    >>> import residua as rs
    >>> print(rs.validate.white())
    white, Gaussian
    """
    return White(size)


def coloured(correlation: float, size: float = 1.0) -> NoiseModel:
    r"""Return a first-order autoregression, :math:`w_k = \varphi w_{k-1} + \sqrt{1 - \varphi^2}\, e_k`.

    Parameters
    ----------
    correlation : float
        :math:`\varphi`, of one sample with the next, between -1 and 1.
    size : float
        Standard deviation.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> drawn = rs.validate.coloured(0.9, size=2.0).draw(np.random.default_rng(0), 10_000, 1)[:, 0]
    >>> bool(abs(np.corrcoef(drawn[1:], drawn[:-1])[0, 1] - 0.9) < 0.02)
    True
    """
    return Coloured(size, correlation)


def heavy_tailed(degrees: float = 4.0, size: float = 1.0) -> NoiseModel:
    r"""Return noise of Student's t distribution, :math:`w_k = t_\nu \sqrt{(\nu - 2)/\nu}`.

    Parameters
    ----------
    degrees : float
        :math:`\nu`, over 2; the fewer, the heavier the tails.
    size : float
        Standard deviation.

    Examples
    --------
    >>> import residua as rs
    >>> print(rs.validate.heavy_tailed(4))
    heavy-tailed, Student t with 4 degrees of freedom
    """
    return HeavyTailed(size, degrees)


def resampled(residuals: Any, *, block: int | None = None) -> Resampled:
    """Return a block bootstrap of fault-free residuals: noise for runs without a credible noise model.

    A campaign then draws residuals instead of measurements: every run has blocks of the recorded residuals, one after
    the other, plus the response of the plant without noise, faults included, through the filter of the monitor.
    Exact for additive faults in a linear loop. A stuck or weakened channel is that of the noise-free signal.

    Parameters
    ----------
    residuals : Diagnosis, array_like of shape (time, residuals), or a list of these
        Of fault-free recordings; of a diagnosis its decided samples: ``resampled(monitor.run(u, y))``.
    block : int, optional
        Samples of a block. When omitted the cubic root of their number, or five times as long as they are correlated
        where that is more.

    Raises
    ------
    DataError
        If a residual is not a finite number where it should be, or no stretch is as long as a block.

    References
    ----------
    Kunsch (1989), Annals of Statistics 17(3), 1217-1241.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> print(rs.validate.resampled(np.random.default_rng(0).standard_normal((1000, 2)), block=20))
    resampled from 1,000 fault-free residuals in blocks of 20
    """
    parts = residuals if isinstance(residuals, (list, tuple)) else [residuals]
    stretches = [piece for part in parts for piece in _stretches(part)]
    if not stretches or len({piece.shape[1] for piece in stretches}) > 1:
        raise DataError("resampled needs fault-free residuals, (time, residuals), as many columns in each")
    whole = np.ascontiguousarray(np.concatenate(stretches))
    ends = np.cumsum([len(piece) for piece in stretches])
    if block is None:
        parts_of = [slice(int(end) - len(piece), int(end)) for piece, end in zip(stretches, ends, strict=True)]
        correlated = float(correlation_times(whole - whole.mean(axis=0), parts_of).max())
        block = max(1, int(np.ceil(max(len(whole) ** (1 / 3), _TIMES * correlated))))
        block = min(block, max(map(len, stretches)))
    check_samples(block, "block")
    starts = [np.arange(end - len(piece), end - block + 1) for piece, end in zip(stretches, ends, strict=True)]
    possible = np.concatenate(starts).astype(np.int64)
    if not len(possible):
        raise DataError(f"no stretch of residuals is as long as a block of {block} samples: choose a shorter block")
    return Resampled(whole, possible, int(block))


def _stretches(part: Any) -> Sequence[NDArray[np.float64]]:
    """Return the usable stretches of one recording's residuals."""
    values: ArrayLike = getattr(part, "residuals", part)
    try:
        rows = np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise DataError(f"residuals must be numbers of (time, residuals): {error}") from error
    rows = rows[:, None] if rows.ndim == 1 else rows
    if rows.ndim != 2 or not rows.size:
        raise DataError(f"residuals must be (time, residuals), got shape {rows.shape}")
    decided = getattr(part, "decided", None)
    if decided is None:
        if not np.isfinite(rows).all():
            raise DataError("residuals must be finite numbers: leave out those that are missing, or give the diagnosis")
        return [rows]
    fine = np.flatnonzero(decided & np.isfinite(rows).all(axis=1))
    return np.split(rows[fine], np.flatnonzero(np.diff(fine) > 1) + 1) if len(fine) else []
