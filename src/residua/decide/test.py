"""Interface of tests, which turn residuals into a statistic and an alarm.

A test is two classes in one file. Its *settings* are written by users; they make the fitted test from the noise model
of a plant, or from fault-free data. A monitor knows no kind of test: it uses the methods below. A test of your own is
written the same way, in a file outside of the package (:func:`residua.decide.register`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import rate_aimed_at
from residua.decide.compiled import CompiledTest
from residua.design import ResidualGenerator
from residua.records import Record, values_in, values_out

#: Where faults have other responses than as a rule: plant, sample, and the whitened responses by age, shape
#: (window + 1, faults, residuals), with one more row for those that arrived before the window.
Bends = Sequence[tuple[int, int, NDArray[np.float64]]]


@dataclass(frozen=True, eq=False)
class Watched:
    """Generator, parts and certified thresholds for which a test is made.

    Attributes
    ----------
    generator : ResidualGenerator
        Sampled.
    parts : mapping of str to tuple of int, or None
        Residual numbers of the parts to test separately, by name, for an isolation by the parts that fired:
        the members of a bank. ``None`` if the residual is tested as a whole.
    certified : mapping of str to float
        Thresholds that the design has certified, by member; empty for a design that brings none.
    """

    generator: ResidualGenerator
    parts: Mapping[str, tuple[int, ...]] | None = None
    certified: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class FaultFreeRun:
    """Residuals of a generator over fault-free recordings, one after the other.

    Attributes
    ----------
    residuals : ndarray, shape (time, k)
    usable : ndarray of bool, shape (time,)
        Not while a filter settles: each recording has its own start.
    seams : tuple of int
        The first sample of each further recording: nothing goes across.
    levels : ndarray, shape (k,)
        For each residual the size of the signals that it is the difference of.
    signals : ndarray, shape (time, channels), or None
        Their source: inputs, then outputs, as deviations from the operating point; NaN where missing.
    """

    residuals: NDArray[np.float64]
    usable: NDArray[np.bool_]
    seams: tuple[int, ...]
    levels: NDArray[np.float64]
    signals: NDArray[np.float64] | None = None

    def signal_size(self, rows: Sequence[int] | None = None) -> float:
        """Return the size of the signals that cancel in some residuals, or in all of them."""
        return float(np.max(self.levels[slice(None) if rows is None else list(rows)], initial=0.0))


@dataclass(frozen=True, eq=False)
class Block:
    """Block of residuals for a test.

    Attributes
    ----------
    residuals : ndarray, shape (plants, time, k)
        NaN where a value is missing.
    usable : ndarray of bool, shape (plants, time)
        Where a decision can be taken.
    count : int, or ndarray of int, shape (plants,)
        Samples before this block.
    bends : sequence
        Where faults have other responses for a while; see :data:`Bends`.
    signals : ndarray, shape (plants, time, channels), or None
        Source of the residuals: inputs, then outputs, as deviations; NaN where a value is missing. ``None``
        where residuals come by themselves.
    """

    residuals: NDArray[np.float64]
    usable: NDArray[np.bool_]
    count: int | NDArray[np.int64] = 0
    bends: Bends = ()
    signals: NDArray[np.float64] | None = None


def _nothing() -> NDArray[Any]:
    return np.zeros((0, 0, 0))


@dataclass(frozen=True, eq=False)
class Tested:
    """Result of a test on a block; every array starts with (plants, time), or (time,) for one plant.

    Attributes
    ----------
    usable : ndarray of bool
        Where something is decided: at most where the block is usable.
    statistic : ndarray
        NaN where nothing is decided.
    exceeded : ndarray of bool
        Whether it is over the threshold.
    alarm : ndarray of bool
    up : ndarray of int
        Samples in a row over the threshold.
    whitened : ndarray, shape (..., k)
        The residual, zero where not usable, in units in which its direction is judged.
    part_statistics, fired : ndarray, shape (..., parts)
        Statistic and alarm of each part tested separately. No columns without such parts.
    likelihood : dataclass or None
        Of a test that compares hypotheses: input of an isolation that belongs to it.
    """

    __test__: ClassVar[bool] = False  # no test of pytest's

    usable: NDArray[np.bool_]
    statistic: NDArray[np.float64]
    exceeded: NDArray[np.bool_]
    alarm: NDArray[np.bool_]
    up: NDArray[np.int64]
    whitened: NDArray[np.float64]
    part_statistics: NDArray[np.float64]
    fired: NDArray[np.bool_]
    likelihood: Any = None


class ResidualTest(Record, ABC):
    """Base of tests with all parameters set. A frozen dataclass with at least the attributes below.

    Attributes
    ----------
    center : ndarray, shape (k,)
        Fault-free mean of the residual.
    threshold : float
        Of the statistic.
    basis : str
        Where the threshold comes from, in words.
    """

    center: NDArray[np.float64]
    threshold: float
    basis: str
    #: Samples from a start to a false alarm, on average, or fewer; ``None`` where that is not known.
    mean_time: float | None = None
    #: Fraction of fault-free samples in alarm that the data of a fit promise not to be exceeded on other data, with
    #: 95 % confidence; ``None`` where nothing is known of it.
    promised: float | None = None

    @abstractmethod
    def start(self, plants: int) -> Any:
        """Return the state before the first sample: a frozen dataclass of arrays with a row per plant, and numbers.

        ``None`` if nothing is remembered.
        """

    @abstractmethod
    def run(self, state: Any, block: Block) -> tuple[Any, Tested]:
        """Run over a block of samples, and return the next state and the outcome for each sample.

        A pure function, with the same bits however time is cut into blocks, and for any number of plants at once.
        """

    # ----------------------------------------------- interface to the rest of a monitor

    @property
    def of_residual(self) -> ResidualTest:
        """Part that tests the residual itself: the whole test, unless it looks at other things beside."""
        return self

    @property
    def samples(self) -> int:
        """Number of samples in the statistic; alarms nearer to each other may be merged."""
        return 1

    @property
    def horizon(self) -> int:
        """Samples for which a finite-horizon test holds an alarm after the last sample over; 0 for any other."""
        return 0

    @property
    def reads_signals(self) -> bool:
        """True if the threshold depends on the recorded signals, ``Block.signals``, besides the residual."""
        return False

    @property
    def compiled(self) -> CompiledTest | None:
        """Equivalent for the fused loop, equal to the last bit; ``None`` if there is only :meth:`run`."""
        return None

    @property
    def is_bound(self) -> bool:
        """True if no fault-free run exceeds the thresholds, certified or the user's: then the test waits longer."""
        return False

    @property
    def is_certified(self) -> bool:
        """True if the design has certified the thresholds."""
        return False

    @property
    def metric(self) -> NDArray[np.float64]:
        """Matrix applied to the residual before its direction is judged, ``r @ metric``: shape (k, K)."""
        return np.eye(len(self.center))

    @property
    def per_deviation(self) -> NDArray[np.float64] | None:
        """The map of the residual to units of its standard deviation, shape (k, K); ``None`` if it is not known."""
        return None

    @property
    def per_threshold(self) -> NDArray[np.float64]:
        """Matrix that scales the residual to units of the threshold, shape (k, K)."""
        return self.metric / self.threshold

    @property
    def guarded(self) -> NDArray[np.float64]:
        """Weights that detect values too large to be a measurement, shape (k, K)."""
        return np.abs(self.per_threshold)

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of the parts tested separately; empty if the residual is tested as a whole."""
        return ()

    @property
    def part_thresholds(self) -> NDArray[np.float64]:
        """Thresholds of the parts tested separately."""
        return np.zeros(0)

    @property
    def groups_of_residuals(self) -> dict[str, tuple[int, ...]]:
        """Residual numbers of the groups that users asked to test separately; empty without."""
        return {}

    @property
    def responses(self) -> Any:
        """Responses to faults in the statistic, a ``MatchedTest``; or ``None``."""
        return None

    def fault_free_residuals(self, normal: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return fault-free residuals as modelled by this test; ``None`` without a model.

        Parameters
        ----------
        normal : ndarray, shape (plants, time, k)
            Independent standard normal numbers, of which they are made.
        """
        return None

    def in_white_units(self, response: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return a response of the residual, (time, k), in units in which fault-free ones are white, of variance one.

        ``None`` where the test knows no such units.
        """
        return None

    def leads(
        self, residuals: NDArray[np.float64], changes: NDArray[np.float64], signals: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """Return the responses of the test to faults of size one, relative to the threshold; ``None`` if unknown.

        At each sample: the inverse of the size that is over the threshold in nine of ten runs.

        Parameters
        ----------
        residuals : ndarray, shape (faults, time, k)
            Of each fault from the first sample on, without noise.
        changes : ndarray, shape (faults, time, channels)
            Of the signals.
        signals : ndarray, shape (places, time, channels)
            Fault-free signals, as deviations, to which the changes are small.

        Returns
        -------
        ndarray, shape (faults, time), or None
        """
        return None

    def outside_share(self, tested: Tested) -> float:
        """Return the fraction of decided samples outside of the range of the training data, if a test checks it."""
        return 0.0

    def bands(self) -> tuple[NDArray[np.float64], float]:
        """Return half the width of each residual's band, and the share of its fault-free samples that it holds.

        0 if that is not known: the band ends where the residual alone is over the threshold. By default there is no
        band.
        """
        return np.full(len(self.center), np.inf), 0.0

    def words(self, step: float) -> dict[str, str]:
        """Describe the threshold, the statistic, and the start and end of an alarm.

        Parameters
        ----------
        step : float
            Seconds between samples.
        """
        return {
            "threshold": f"{self.threshold:.4g} ({self.basis})",
            "test": type(self).__name__,
            "alarm": "while the test says so",
        }

    def cautions(self, tested: Tested) -> tuple[str, ...]:
        """Return cautions about an outcome; ``tested`` is that of a whole recording of one plant."""
        return ()

    # --------------------------------------------------------------------------- files

    def to_record(self) -> dict[str, Any]:
        """Return the test as a record for a file."""
        return values_out(self)

    def check(self, watched: Watched) -> None:
        """Raise :class:`residua.errors.FileFormatError` if a test from a file does not fit the watched generator."""

    def check_state(self, state: Any) -> None:
        """Raise :class:`residua.errors.FileFormatError` if a state from a file is invalid."""


class TestSettings(Record, ABC):
    """Base of the settings of tests. A frozen dataclass with at least the attributes below.

    Attributes
    ----------
    kind : str
        The mark of its records in files.
    makes : type
        Class of the fitted :class:`ResidualTest`.
    false_alarm_rate : float or None
        Intended fraction of fault-free samples in alarm, unless ``fit`` gets another one; ``None``: one that the log of
        a fit can support (:func:`residua.decide.checks.rate_aimed_at`).
    """

    __test__: ClassVar[bool] = False  # no test of pytest's

    kind: ClassVar[str]
    makes: ClassVar[type[ResidualTest]]
    false_alarm_rate: float | None

    def from_model(self, watched: Watched) -> ResidualTest | None:
        """Return the test that needs no data; ``None`` when data are needed."""
        return None

    def known(self, watched: Watched) -> ResidualTest | None:
        """Return the test if its thresholds do not depend on data, to wait longer, from rest; else ``None``."""
        return None

    @abstractmethod
    def fitted(self, watched: Watched, run: FaultFreeRun, rate: float) -> ResidualTest:
        """Return the test fitted to fault-free data, for a rate of false alarms."""

    # ----------------------------------------------- interface to the rest of a monitor

    def check(self, watched: Watched) -> None:
        """Raise :class:`residua.errors.SettingError` if the settings do not suit the watched generator."""

    def asked(self, watched: Watched, rows: int = 0) -> float:
        """Return the target fraction of fault-free samples in alarm, unless ``fit`` gets another one.

        ``rows`` are the usable fault-free rows that a fit uses; 0 without data.
        """
        return rate_aimed_at(self.false_alarm_rate, rows)

    @property
    def takes_certified(self) -> bool:
        """True if the test can use thresholds certified by a design."""
        return False

    @property
    def uses_certified(self) -> bool:
        """True if certified thresholds are used."""
        return self.takes_certified

    @property
    def remedy(self) -> str:
        """Remedy for a missing threshold, as text after "this monitor has no threshold"."""
        return "fit(u, y) it to fault-free data"

    @property
    def divides(self) -> bool:
        """True if users divided the residual into groups that are tested separately."""
        return False

    def kept(self, watched: Watched) -> tuple[str, int, int] | None:
        """Return the setting of the window, its samples, and the numbers kept for each sample of a plant."""
        return None

    # --------------------------------------------------------------------------- files

    def to_record(self) -> dict[str, Any]:
        """Return the settings as a record for a file, without their kind."""
        return values_out(self)

    @classmethod
    def from_record(cls, content: Any, where: str) -> Self:
        """Return the settings that a record describes."""
        return values_in(content, where, cls)

    def check_record(self, content: Mapping[str, Any], where: str) -> None:
        """Raise if a record of a test does not match these settings, before anything is built from it."""

    def test_from_record(self, content: Any, where: str, watched: Watched) -> ResidualTest:
        """Read a test from a record, and check it against the watched generator."""
        test = values_in(content, where, self.makes)
        test.check(watched)
        return test


__all__ = ["Bends", "Block", "FaultFreeRun", "ResidualTest", "TestSettings", "Tested", "Watched"]
