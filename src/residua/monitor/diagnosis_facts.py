"""Facts of a diagnosis beside its series and alarms: of the test, the names, the parts and the recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from residua.decide.structured import CodeTest
from residua.monitor.fault_learning import LearntRow


@dataclass(frozen=True)
class Totals:
    """Length and numbers of samples of a whole recording.

    Attributes
    ----------
    samples : int
    first, last : float
        Times in seconds.
    decided, alarmed : int
        Those where a decision was taken, and of these those in alarm.
    missing, waited : int
        Those with a missing value, and those after them at which the filter settled again.
    absent : tuple of int
        Of each channel those without a value; empty where signals were not kept.
    """

    samples: int
    first: float
    last: float
    decided: int
    alarmed: int
    missing: int
    waited: int
    absent: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class ThresholdFacts:
    """Thresholds of a test, and the normal range of its residuals.

    Attributes
    ----------
    threshold : float
    center, band : ndarray, shape (residuals,)
        Fault-free mean of each residual, and half the width of a band around it: see ``band_share``.
    whitening : ndarray, shape (residuals, residuals)
        Applied as ``(r - center) @ whitening`` before norm and direction are judged; for a bank the members'
        matrices side by side.
    band_share : float
        Fraction of the fault-free samples of one residual, so averaged, that its band holds if its noise is Gaussian;
        0 where its covariance is not known: the residual alone is then over the threshold where its band ends.
    averaged : int
        Samples over which a residual is averaged before it is tested, and its band holds: the window of the test.
    horizon : int
        Samples of the window of a finite-horizon test (:class:`residua.decide.PeakThreshold`); 0 for any other.
    certified : bool
        Whether its thresholds are certified by the design.
    outside : float
        Fraction of the decided samples outside of the learnt range: more than half of the relations are not judged
        there.
    """

    threshold: float
    center: NDArray[np.float64]
    band: NDArray[np.float64]
    whitening: NDArray[np.float64]
    band_share: float = 0.0
    averaged: int = 1
    horizon: int = 0
    certified: bool = False
    outside: float = 0.0


@dataclass(frozen=True, eq=False)
class NamingFacts:
    """Faults that a monitor can name, and what they are named by.

    Attributes
    ----------
    groups : tuple of tuple of str
        The faults, those that this monitor cannot tell apart in one group. A fault of a bank that some members see
        only while it changes is in two (see ``group_names``).
    signatures : tuple of ndarray, shape (residuals, dimension)
        For each group an orthonormal basis of the direction or subspace that it was judged by, in whitened
        residual space; empty for a bank that is read by code. Of matched filters the direction that the first fault
        of the group settles to.
    unjudged : tuple of str
        Faults without a usable signature in this monitor.
    window : int
        Samples over which direction is judged: an alarm that is shorter is not sure of its name. 1 for matched
        filters, whose likelihood tells how sure a name is after any time, and for a dedicated bank with a peak test, of
        which one sample over a threshold names the fault.
    codes : CodeTest or None
        Members, groups and codes of a bank whose members were tested one by one; ``None`` for anything else.
    learnt_faults : tuple of LearntRow
        The faults that were learnt from recordings, as the table of the monitor has them.
    """

    groups: tuple[tuple[str, ...], ...]
    signatures: tuple[NDArray[np.float64], ...] = ()
    unjudged: tuple[str, ...] = ()
    window: int = 1
    codes: CodeTest | None = None
    learnt_faults: tuple[LearntRow, ...] = ()


@dataclass(frozen=True, eq=False)
class PartSeries:
    """Statistics and alarms of parts that are tested one by one: members of a bank, or groups of residuals.

    Attributes
    ----------
    statistics : ndarray, shape (T, parts)
        No columns without parts.
    thresholds : ndarray, shape (parts,)
    fired : ndarray of bool, shape (T, parts)
        Which parts are in alarm at each sample.
    code : ndarray of bool, shape (T, members)
        Which members count as fired over the window that ends there, for the reading.
    residuals : mapping of str to tuple of int
        Where groups of residuals are tested by themselves: the residual numbers of each; else empty.
    """

    statistics: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))
    thresholds: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    fired: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), dtype=bool))
    code: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), dtype=bool))
    residuals: Mapping[str, tuple[int, ...]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class RecordingFacts:
    """Source of a recording, and what was unusual about it.

    Attributes
    ----------
    source : str
        Where the recording came from.
    origin : str
        The moment that ``time`` counts from (ISO 8601), where the recording had dates; else empty.
    resets : int
        How often the filter was restarted after a long gap.
    predicted : bool
        Whether the filter, a Kalman filter, went on with those outputs of a sample that were there; else values were
        held.
    is_unlike_the_fit : bool
        Whether a channel never comes near its values in the recordings of the fit; the notes name it.
    compared : tuple of (int, int)
        Residuals that are a measured output less its prediction from all that was measured before, as pairs (residual,
        output); see ``Diagnosis.predictions``.
    thinned : bool
        Whether the series are those of a chart only: the smallest and largest value of each bin of samples, as
        :meth:`residua.Monitor.run_file` leaves them of long recordings. Alarms, whose ``start`` and ``stop`` are sample
        numbers of the recording, notes and numbers of samples are those of the whole.
    table : str
        Where the full table is then; empty if it was not written.
    counted : Totals or None
        The numbers of samples of the whole then; see ``Diagnosis.totals``.
    """

    source: str = ""
    origin: str = ""
    resets: int = 0
    predicted: bool = False
    is_unlike_the_fit: bool = False
    compared: tuple[tuple[int, int], ...] = ()
    thinned: bool = False
    table: str = ""
    counted: Totals | None = None
