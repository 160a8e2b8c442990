"""Faults known from recordings of them: a direction with its cone, or a code."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.dependence import correlation_times
from residua.decide.whitened_norm import BAND_SHARE
from residua.errors import DataError
from residua.number_kinds import COUNT, PART, POSITIVE, NumberKind
from residua.records import Record
from residua.words import counted

#: Share of the cones that hold the direction, and of the windows of a learnt fault that are taken for it.
CONE_SHARE, WINDOW_SHARE = 0.95, 0.99
#: Half-angle in degrees from which on a cone says nothing: a line lies within 90 degrees of any other.
WIDEST = 60.0
#: Degrees of freedom from which on the spread between recordings is judged by the F distribution.
_LEAST_FREEDOM = 3


@dataclass(frozen=True, eq=False)
class LearntFault(Record):
    """A fault as shown by recordings of it.

    Attributes
    ----------
    name : str
    recordings : int
        Occurrences that it is from.
    samples : int
        Of the residual, while the fault was there.
    independent : float
        Independent samples that these are worth.
    shift : ndarray, shape (k,)
        Mean of the residual less its fault-free mean, in units of the residuals; of several recordings the mean of
        these, with their signs turned to agree. No entries where the fault is known by its code.
    error : ndarray, shape (k, k)
        Covariance of ``shift`` by the scatter of the residual.
    noise : ndarray, shape (k, k)
        Covariance of the mean of the residual over one window while the fault is there.
    between : ndarray, shape (k, k)
        Covariance of the shifts of single recordings, brought to the same size; zero for one recording.
    cone : float
        Half-angle in degrees of the cone that holds the direction with 95 % confidence; 0 for a code.
    code : ndarray of bool, shape (members,)
        Which members of a bank it fires; no entries where it is known by its direction.
    share : float
        Part of the samples, in alarm, in which just these members counted as fired; of a direction 1.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {
        "recordings": COUNT,
        "samples": COUNT,
        "independent": POSITIVE,
        "share": PART,
    }

    name: str
    recordings: int
    samples: int
    independent: float
    shift: NDArray[np.float64]
    error: NDArray[np.float64]
    noise: NDArray[np.float64]
    between: NDArray[np.float64]
    cone: float
    code: NDArray[np.bool_]
    share: float = 1.0

    @property
    def by_code(self) -> bool:
        """True if the fault is known by its code."""
        return bool(self.code.size)

    @property
    def basis(self) -> str:
        """Description of the data from which it was learnt."""
        text = f"{counted(self.recordings, 'recording')}, {self.samples} samples"
        if self.by_code:
            return f"{text}, its code in {100 * self.share:.0f} % of them"
        return f"{text} worth {self.independent:.3g} independent ones, cone of {self.cone:.2g}°"


@dataclass(frozen=True, eq=False)
class _Occurrence:
    """One recording of a fault, in whitened units: its mean, and the covariances of that and of a window's mean."""

    mean: NDArray[np.float64]
    error: NDArray[np.float64]
    noise: NDArray[np.float64]
    samples: int
    independent: float


def learnt_direction(
    name: str, rows: Sequence[NDArray[np.float64]], space: NDArray[np.float64], window: int
) -> LearntFault:
    r"""Return the direction of a fault from residuals during it, in one recording or several.

    .. math::

       \hat s = \bar q, \qquad \operatorname{cov} \hat s = \frac{1}{N} \sum_i \lambda_i \tau_i v_i v_i^T,
       \qquad \tan \alpha = \frac{\varrho_{95}(\operatorname{cov} \hat s_\perp)}{\|s\|}

    with eigenvalues :math:`\lambda_i`, 1 or more, and vectors :math:`v_i` of the covariance of the whitened residual,
    and the correlation time :math:`\tau_i` of each component. Of several recordings, the larger of this and of
    the spread of their own directions about their mean.

    Parameters
    ----------
    name : str
    rows : sequence of ndarray, shape (time, k)
        Residuals less their fault-free mean.
    space : ndarray, shape (k, k)
        Their whitening, applied as ``rows @ space``: fault-free they have the covariance 1 there.
    window : int
        Samples that a name is judged over.

    Raises
    ------
    DataError
        If a recording cannot be distinguished from fault-free data, or the cone is wider than 60 degrees.

    References
    ----------
    Mardia and Jupp (2000), Directional statistics, section 10.4 (cones of axes); Welch (1947) and Satterthwaite (1946)
    for the distribution of sums of squares; Sokal (1997), section 3, for the correlation time.
    """
    seen = [_occurrence(name, one @ space, window, k, len(rows)) for k, one in enumerate(rows, 1)]
    signs = [1.0 if one.mean @ seen[0].mean >= 0 else -1.0 for one in seen]
    mean = np.mean([sign * one.mean for sign, one in zip(signs, seen, strict=True)], axis=0)
    error = np.sum([one.error for one in seen], axis=0) / len(seen) ** 2
    noise = np.mean([one.noise for one in seen], axis=0)
    samples, independent = sum(one.samples for one in seen), sum(one.independent for one in seen)
    size = float(np.linalg.norm(mean))
    # the covariance of single shifts about their mean, each scaled to its size
    along = [(one.mean, float(one.mean @ mean)) for one in seen]
    away = [shift * size**2 / product - mean for shift, product in along if product != 0.0 and len(seen) > 1]
    between = np.zeros_like(space) + sum(np.outer(one, one) for one in away) / max(len(seen) - 1, 1)
    cone = 90.0
    if size > 0:
        sideways = across(mean / size, error)
        occurrence = occurrence_square(between, len(seen), CONE_SHARE, new=False)
        radius = max(square_at(sideways, CONE_SHARE, independent), occurrence)
        length = size**2 - float(np.trace(sideways))  # errors lengthen the measured shift
        cone = math.degrees(math.atan2(math.sqrt(radius), math.sqrt(max(length, 0.0))))
    if not cone <= WIDEST:
        raise DataError(
            f"the direction of {name!r} is known to {cone:.0f}° only (95 % confidence), no more than {WIDEST:g}° is "
            f"taken: {samples} samples are worth {independent:.3g} independent ones. Give a longer recording, a larger "
            "fault, or several recordings"
        )
    back = np.linalg.inv(space)
    error, noise, between = (back.T @ M @ back for M in (error, noise, between))
    no_code = np.zeros(0, dtype=bool)
    return LearntFault(name, len(seen), samples, independent, mean @ back, error, noise, between, cone, no_code)


def _occurrence(name: str, q: NDArray[np.float64], window: int, number: int, of: int) -> _Occurrence:
    """Return the mean of one recording with its covariance, or raise if it shows no fault."""
    from scipy.special import fdtrc  # slow to import, and needed only here

    which = f"recording {number} of {of}" if of > 1 else "the recording"
    count, k = q.shape
    if count < 2:
        raise DataError(f"{which} of {name!r} has {counted(count, 'usable sample')} in the interval of the fault")
    mean = q.mean(axis=0)
    away = q - mean
    if not np.any(mean):
        raise DataError(f"{which} of {name!r} shows no fault: the mean of its residuals is the fault-free one")
    # Variation of a fault along its own direction is not an error of the direction.
    direction = mean / np.linalg.norm(mean)
    values, vectors = np.linalg.eigh(across(direction, away.T @ away / (count - 1)))
    vectors[:, 0] = direction  # at right angles to all others, where nothing is left
    vectors = np.linalg.qr(vectors)[0]
    values = np.maximum(np.sum((away @ vectors) ** 2, axis=0) / (count - 1), 1.0)  # less than without a fault is chance
    times = _times(away @ vectors)
    lasting = values * times
    error, noise = (
        (vectors * weights) @ vectors.T for weights in (lasting / count, np.minimum(lasting / window, values))
    )
    sideways = slice(1, None) if k > 1 else slice(None)
    independent = float(count * values[sideways].sum() / lasting[sideways].sum())
    square = float(np.sum((vectors.T @ mean) ** 2 * count / times))
    chance = float(fdtrc(k, max(count / times.mean() - 1, 1.0) * k, square / k))
    if not chance < 1 - BAND_SHARE:
        raise DataError(
            f"{which} of {name!r} shows no fault: the mean of its residuals over {count} samples (worth "
            f"{independent:.3g} independent ones) is as far from the fault-free mean as chance takes it with a "
            f"probability of {chance:.2g}; give the interval of the fault, or a recording with a larger one"
        )
    return _Occurrence(mean, error, noise, count, independent)


def _times(columns: NDArray[np.float64]) -> NDArray[np.float64]:
    r"""Return the correlation times of columns less their own means.

    That lowers each correlation by :math:`\tau / N`, and the sum over ``L`` lags by :math:`2 L \tau / N`, with ``L`` of
    five times :math:`\tau`, and a quarter of the samples at most.
    """
    count = len(columns)
    times = correlation_times(columns, [slice(0, count)])
    lost = 2 * np.minimum(5 * times, count / 4) / count
    return np.minimum(np.where(times > 1, times / (1 - lost), times), float(count))


def across(direction: NDArray[np.float64], covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the part of a covariance that is at right angles to a direction of length 1."""
    P = np.eye(len(direction)) - np.outer(direction, direction)
    return P @ covariance @ P


def square_at(covariance: NDArray[np.float64], share: float, independent: float = math.inf) -> float:
    """Return a quantile of the squared length of a Gaussian vector, by its first two moments.

    ``independent`` is the number of independent samples that the covariance is from.
    """
    from scipy.special import chdtri, fdtri  # slow to import, and needed only here

    total, squares = float(np.trace(covariance)), float(np.sum(covariance**2))
    if not total > 0 or not squares > 0:
        return 0.0
    dimensions = total**2 / squares
    if not math.isfinite(independent):
        return total / dimensions * float(chdtri(dimensions, 1 - share))
    freedom = max(2.0, dimensions * (independent - 1))
    return total * float(fdtri(dimensions, freedom, share))


def occurrence_square(between: NDArray[np.float64], recordings: int, share: float, new: bool) -> float:
    """Return a quantile for the mean of occurrences, or for a new one, by the spread between those seen.

    It is taken to be the same in all ``k - 1`` directions across; where so few were seen that its own error has fewer
    than three degrees of freedom, that error is left out.
    """
    from scipy.special import chdtri, fdtri  # slow to import, and needed only here

    across_dimensions = len(between) - 1
    if recordings < 2 or across_dimensions < 1:
        return 0.0
    each = float(np.trace(between)) / across_dimensions * (1 / recordings + (1.0 if new else 0.0))
    freedom = (recordings - 1) * across_dimensions
    if freedom < _LEAST_FREEDOM:
        return each * float(chdtri(across_dimensions, 1 - share))
    return each * across_dimensions * float(fdtri(across_dimensions, freedom, share))


def angle_between(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Return the angle in degrees between a line and the line or plane of a basis; 90 where one is zero."""
    size = float(np.linalg.norm(a))
    if not size > 0 or not b.size:
        return 90.0
    inside = b.reshape(len(a), -1) @ (b.reshape(len(a), -1).T @ a)
    return math.degrees(math.atan2(float(np.linalg.norm(a - inside)), float(np.linalg.norm(inside))))


def learnt_code(
    name: str, patterns: Sequence[tuple[NDArray[np.bool_], float]], samples: int, members: Sequence[str]
) -> LearntFault:
    """Return the code of a fault from the pattern of each recording and the share of its samples in which it stood.

    Raises
    ------
    DataError
        If no member fired, or not the same ones in all recordings.
    """
    texts = [" and ".join(m for m, on in zip(members, code, strict=True) if on) for code, _ in patterns]
    if not all(texts):
        raise DataError(f"no member of the bank fires in the interval of {name!r}: it shows no fault")
    if len(set(texts)) > 1:
        raise DataError(
            f"the recordings of {name!r} fire different members ({'; '.join(dict.fromkeys(texts))}): to this bank they "
            "are different faults, learn each under a name of its own"
        )
    code, none = patterns[0][0], np.zeros((0, 0))
    share = float(np.mean([share for _, share in patterns]))
    return LearntFault(
        name, len(patterns), samples, float(samples), np.zeros(0), none, none, none, 0.0, code.copy(), share
    )
