"""Finite-horizon test: a fault is declared while the largest residual of a moving window exceeds a threshold."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self, SupportsFloat

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.decide.checks import check_rate, check_samples, is_number
from residua.decide.compiled import CompiledTest
from residua.decide.false_alarms import observed
from residua.decide.fault_free import FaultFree
from residua.decide.member_thresholds import BankTest, Parts, fit_together, rows_of, side_by_side
from residua.decide.row_norms import row_norms
from residua.decide.test import FaultFreeRun, ResidualTest, Tested, TestSettings, Watched
from residua.decide.whitened_norm import Fitted, NormTest, with_threshold
from residua.errors import DataError, FileFormatError, SettingError
from residua.number_kinds import COUNT, POSITIVE, PROBABILITY
from residua.records import field_names, float_in, joined, record, values_in, values_out, whole_in
from residua.tolerances import SIGNAL_ROUNDING
from residua.visible import echo
from residua.words import counted

#: How the basis of a test begins whose thresholds are certified by the design, or set by the user.
CERTIFIED = "certified by the design over its uncertainty set"
GIVEN = "threshold given"

#: Characters up to which an error repeats the value.
_LONGEST = 80
#: Members whose shares of their thresholds a basis tells one by one.
_TOLD = 8


def told_sample(sample: int, seams: Sequence[int]) -> str:
    """Describe the place of a sample, and its recording if there are several."""
    if not seams:
        return f"sample {sample}"
    before = [0, *(int(s) for s in seams)]
    number = max(i for i, start in enumerate(before) if start <= sample)
    return f"sample {sample - before[number]} of recording {number + 1}"


class _Peak:
    """Common part of tests of peaks, of the residual as a whole or of members one by one."""

    basis: str
    release: int
    whitening: NDArray[np.float64]
    band: NDArray[np.float64]

    @property
    def horizon(self) -> int:
        """Length of the window."""
        return self.release

    @property
    def is_bound(self) -> bool:
        """True if thresholds are certified or set by the user, and not fitted to data."""
        return self.basis.startswith((CERTIFIED, GIVEN))

    @property
    def is_certified(self) -> bool:
        """True if the design has certified the thresholds."""
        return self.basis.startswith(CERTIFIED)

    @property
    def per_deviation(self) -> NDArray[np.float64] | None:
        """Return ``None``: the spread is unknown."""
        return None

    def bands(self) -> tuple[NDArray[np.float64], float]:
        """Return the band of each residual alone, below its threshold."""
        return self.band, 0.0

    def _said(self, step: float, several: bool) -> str:
        """Describe the statistic."""
        origin = "certified by the design" if self.is_certified else self.basis.split(" ")[0]
        origin = {"each": "fitted", "threshold": "given"}.get(origin, origin)
        whose = "the residual"
        if several:
            whose = "each member's residual; the statistic is the largest ratio to its threshold"
        return (
            f"finite-horizon peak test, window {self.release} samples ({self.release * step:g} s), "
            f"threshold{'s' if several else ''} {origin}: norm of {whose}"
        )


@dataclass(frozen=True, eq=False)
class PeakTest(_Peak, NormTest):
    """A finite-horizon test of the residual as a whole; see ``NormTest``."""

    kind: str = "peak"

    @property
    def guarded(self) -> NDArray[np.float64]:
        """Weights in thresholds."""
        return np.abs(self.whitening) / self.threshold

    @property
    def compiled(self) -> CompiledTest | None:
        """Equivalent for the fused loop."""
        return self._in_c() if type(self) is PeakTest else None

    def words(self, step: float) -> dict[str, str]:
        """Describe the threshold, the statistic, and the start and end of an alarm."""
        alarm = f"raised by one sample over it, ended by {self.release} below it"
        return super().words(step) | {"test": self._said(step, False), "alarm": alarm}

    def cautions(self, tested: Tested) -> tuple[str, ...]:
        """Return a caution about the units of a recording."""
        return _unit_cautions(self, tested.usable, tested.statistic[:, None], np.array([self.threshold]))


@dataclass(frozen=True, eq=False)
class PeakBankTest(_Peak, BankTest):
    """Finite-horizon tests of the members of a bank; see ``BankTest``."""

    kind: str = "peak"

    @property
    def guarded(self) -> NDArray[np.float64]:
        """Weights in thresholds."""
        return np.abs(self.whitening) / np.repeat(self.thresholds, self.sizes)

    @property
    def compiled(self) -> CompiledTest | None:
        """Equivalent for the fused loop."""
        return self._in_c() if type(self) is PeakBankTest else None

    def words(self, step: float) -> dict[str, str]:
        """Describe the thresholds, the statistic, and the start and end of an alarm."""
        said = self._said(step, len(self.thresholds) > 1)
        return super().words(step) | {"test": said, "alarm": self._raised("one sample")}

    def cautions(self, tested: Tested) -> tuple[str, ...]:
        """Return a caution about the units of a recording."""
        return _unit_cautions(self, tested.usable, tested.part_statistics, self.thresholds)


#: Times its threshold that every residual reaches at once where units or operating point are to be doubted.
_FAR = 10.0


def _unit_cautions(
    test: PeakTest | PeakBankTest, usable: NDArray[np.bool_], statistics: NDArray[np.float64], limits: NDArray
) -> tuple[str, ...]:
    """Return a caution if every residual is far over a bound from the first decision on.

    A fitted threshold would have shown it; one that is certified or set by the user has never seen the data.
    """
    judged = np.flatnonzero(usable)[: test.release]
    if not test.is_bound or not len(judged):
        return ()
    ratios = statistics[judged] / limits
    smallest = float(ratios.max(axis=0).min())
    if not (ratios[0] > 1).all() or smallest < _FAR:
        return ()
    every = "every residual" if len(limits) > 1 else "the residual"
    return (
        f"from the first judged sample on {every} is far over its threshold ({smallest:.3g} times and more): is the "
        "recording in the units, signs and order of the model, and is its operating point that of the plant?",
    )


@dataclass(frozen=True)
class PeakThreshold(TestSettings):
    r"""Alarm while the largest norm of the residual over a moving window exceeds a threshold.

    .. math:: \max_{N_0 \le k \le N} |r(k)|_2 > J_{th}

    at sample :math:`N`, over the last ``window`` samples :math:`N_0 = N - window + 1` to :math:`N`. The residual is
    neither centred nor whitened: a threshold that a design has certified is a bound of :math:`|r|_2` itself.

    Guaranteed: if :math:`|r(k)|_2 \le J_{th}` for every fault-free run, as a certified threshold promises for all
    disturbances :math:`|w(k)|_2 \le 1` and all plants of the uncertainty set, there is no false alarm, not one.

    A monitor runs it as the alarm logic of :class:`residua.decide.NormThreshold` with ``persistence=1`` and
    ``release=window``, which is the same test. One sample over the threshold raises the alarm, and it ends at the
    ``window``-th sample in a row that is not over it. So if any of the last ``window`` samples is over, the last
    such raised the alarm, and fewer than ``window`` not over have followed: it stands. If none is, either the last of
    them has ended it, or it never was raised. The maximum needs no memory of its own, and streamed samples give the
    same bits as a whole recording.

    Assumes that the filter has settled: a certified threshold holds from an initial error of zero, or once the
    transient of the start has decayed (``Monitor(settle=...)``). Samples that are not judged, because values are
    missing or the filter settles again, do not belong to the window: it holds the last ``window`` judged samples and
    reaches further back in time over a gap. Meanwhile an alarm neither begins nor ends.

    Parameters
    ----------
    thresholds : float, mapping of str to float, or sequence of float, optional
        :math:`J_{th}` in the unit of the residual: one number for all members of a bank, or for a residual that is
        tested as a whole; by name of the member; or in the order of the members. A number is whatever ``float`` takes
        as one, a :class:`residua.design.CertifiedThreshold` as well: the outcome of
        :func:`residua.design.certified_thresholds` can be used as it is. When omitted, those that the design
        has certified (its ``thresholds``); without any, fitted to fault-free data (:meth:`residua.Monitor.fit`).
    window : int
        Samples of the window, the last one included.
    false_alarm_rate : float, optional
        Intended fraction of fault-free samples in alarm for fitted thresholds, one that the log can support when
        omitted (see :class:`residua.decide.NormThreshold`); it does not change thresholds that the user sets or the
        design certifies.

    Raises
    ------
    SettingError
        If a threshold is not a positive number, or the window is not a positive number of samples.

    References
    ----------
    Robust l1 fault detection, eq. (49); the thresholds: eqs. (41)-(48).

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"]).with_sensor_faults()
    >>> observer = rs.design.detection_filter(plant, poles=[0.5])
    >>> monitor = rs.Monitor(observer, test=rs.decide.PeakThreshold(0.25, window=60))
    >>> y = np.ones((200, 1))
    >>> y[100] += 1.0
    >>> diagnosis = monitor.run(np.ones((200, 1)), y)
    >>> print([(alarm.raised, alarm.ended) for alarm in diagnosis.alarms])
    [(100.0, 161.0)]
    """

    kind: ClassVar[str] = "peak"
    makes: ClassVar[type[ResidualTest]] = PeakTest

    thresholds: SupportsFloat | Mapping[str, SupportsFloat] | Sequence[SupportsFloat] | None = None
    window: int = 60
    false_alarm_rate: float | None = None

    def __post_init__(self) -> None:
        """Check the settings."""
        object.__setattr__(self, "thresholds", _checked(self.thresholds))
        check_samples(self.window, "window")
        check_rate(self.false_alarm_rate)
        object.__setattr__(self, "window", int(self.window))
        rate = self.false_alarm_rate
        object.__setattr__(self, "false_alarm_rate", None if rate is None else float(rate))

    def for_members(self, members: Sequence[str]) -> tuple[float, ...] | None:
        """Return the threshold of every member, or the one of a residual without members; ``None`` without any.

        Raises
        ------
        SettingError
            If they are not one for each.
        """
        thresholds = self.thresholds
        if thresholds is None:
            return None
        if not isinstance(thresholds, (Mapping, Sequence)):
            return (float(thresholds),) * max(1, len(members))
        if (not members and len(thresholds) > 1) or (isinstance(thresholds, Mapping) and not members):
            raise SettingError(
                "thresholds one by one are for the members of a bank that is read by code, isolate=Structured(); "
                "here the residual is tested as a whole: give one number (of a design with one member, float() of its)"
            )
        if isinstance(thresholds, Mapping):
            missing, unknown = [m for m in members if m not in thresholds], [m for m in thresholds if m not in members]
            if missing or unknown:
                raise SettingError(
                    f"thresholds must name each member once: {', '.join(map(repr, members))}; "
                    + "; ".join(
                        f"{what} {', '.join(map(repr, names))}"
                        for what, names in (("missing", missing), ("unknown", unknown))
                        if names
                    )
                )
            return tuple(float(thresholds[name]) for name in members)
        if len(thresholds) != max(1, len(members)):
            raise SettingError(
                f"expected {len(members)} thresholds, one for each of {', '.join(map(repr, members))}, "
                f"got {len(thresholds)}"
            )
        return tuple(map(float, thresholds))

    def from_model(self, watched: Watched) -> NormTest | BankTest | None:
        """Return the test with the thresholds that the user sets or the design certifies; ``None`` without any."""
        settings, basis = self, GIVEN
        if settings.thresholds is None and watched.certified:
            settings, basis = replace(settings, thresholds=dict(watched.certified)), CERTIFIED
        thresholds = settings.for_members(tested_members(watched))
        if thresholds is None:
            return None
        return peak_test(settings, thresholds, basis, watched.generator.n_residuals, watched.parts)

    def known(self, watched: Watched) -> NormTest | BankTest | None:
        """Return the test with the thresholds that the user sets or the design certifies."""
        return self.from_model(watched)

    def fitted(self, watched: Watched, run: FaultFreeRun, rate: float) -> NormTest | BankTest:
        """Return the test fitted to fault-free data; known thresholds stay, and are checked against them."""
        known, parts = self.from_model(watched), watched.parts
        if known is not None:
            return checked_peak_test(known, run.residuals, run.usable, list(parts or ()), run.seams)
        sizes = [run.signal_size(rows) for rows in parts.values()] if parts else [run.signal_size()]
        return fit_peak_test(
            self, run.residuals, run.usable, false_alarm_rate=rate, signal_sizes=sizes, members=parts, seams=run.seams
        )

    # ----------------------------------------------- interface to the rest of a monitor

    def check(self, watched: Watched) -> None:
        """Raise if the thresholds do not fit the tested members."""
        tested = tested_members(watched)
        self.for_members(tested)
        if self.thresholds is not None or not watched.certified:
            return
        if not tested:
            raise SettingError(
                "the certified thresholds of this design are for its members one by one: isolate=Structured(), or give "
                "one for the residual as a whole, test=PeakThreshold(...), or test=NormThreshold()"
            )
        if not watched.generator.system.is_discrete:
            raise SettingError(
                "the certified thresholds of this design are for its continuous filter, and a monitor runs a sampled "
                "one: design for the sampled plant, plant.discretize(dt), or test=NormThreshold()"
            )

    @property
    def takes_certified(self) -> bool:
        """True if the test can use thresholds certified by a design."""
        return True

    @property
    def uses_certified(self) -> bool:
        """True if the user gave no thresholds, so that certified ones are used."""
        return self.thresholds is None

    @property
    def remedy(self) -> str:
        """Remedy for a missing threshold."""
        return f"{super().remedy}, or set PeakThreshold(thresholds=...)"

    # --------------------------------------------------------------------------- files

    def to_record(self) -> dict[str, Any]:
        """Return the settings as a record: one threshold, a list, or a table of them."""
        own = self.thresholds
        thresholds = list(own) if isinstance(own, tuple) else dict(own) if isinstance(own, dict) else own
        return values_out(self) | {"thresholds": thresholds}

    @classmethod
    def from_record(cls, content: Any, where: str) -> Self:
        """Return the settings that a record describes."""
        content = record(content, where, field_names(cls))
        rate = content["false_alarm_rate"]
        rate = None if rate is None else float_in(rate, joined(where, "false_alarm_rate"), PROBABILITY)
        window = whole_in(content["window"], joined(where, "window"), COUNT)
        return cls(_thresholds_in(content["thresholds"], joined(where, "thresholds")), window, rate)

    def test_from_record(self, content: Any, where: str, watched: Watched) -> ResidualTest:
        """Read a test from a record."""
        test = values_in(content, where, PeakTest if watched.parts is None else PeakBankTest)
        if test.kind != self.kind:
            raise FileFormatError(f"{where}.kind must be that of the test, got {echo(test.kind)}")
        test.check(watched)
        return test


def tested_members(watched: Watched) -> list[str]:
    """Return the members with their own thresholds; a single member is tested as a whole."""
    generator = watched.generator
    names = [member.name for member in generator.members]
    alone = len(names) == 1 and len(generator.members[0].residuals) == generator.n_residuals
    return names if watched.parts is not None or alone else []


def _thresholds_in(value: Any, where: str) -> float | dict[str, float] | list[float] | None:
    if value is None:
        return None
    if isinstance(value, dict):
        return {name: float_in(entry, joined(where, name), POSITIVE) for name, entry in value.items()}
    if isinstance(value, list):
        return [float_in(entry, joined(where, k), POSITIVE) for k, entry in enumerate(value)]
    return float_in(value, where, POSITIVE)


def _checked(thresholds: object) -> float | dict[str, float] | tuple[float, ...] | None:
    """Return thresholds as plain values."""
    if thresholds is None:
        return None
    if isinstance(thresholds, Mapping):
        checked: float | dict[str, float] | tuple[float, ...] = {
            str(name): _positive(value, f"the threshold of {_short(name)}") for name, value in thresholds.items()
        }
    elif isinstance(thresholds, Sequence | np.ndarray) and not isinstance(thresholds, str) and np.ndim(thresholds) == 1:
        checked = tuple(_positive(value, f"threshold {k + 1}") for k, value in enumerate(thresholds))
    else:
        return _positive(thresholds, "the threshold")
    if not checked:
        raise SettingError("thresholds is empty: give one per member, one number for all, or leave it out")
    return checked


def _positive(value: object, what: str) -> float:
    """Return a threshold as a number."""
    one = isinstance(value, SupportsFloat) and not isinstance(value, (bool, np.bool_)) and np.size(value) == 1  # type: ignore[arg-type]
    number = float(value) if one else np.nan  # type: ignore[arg-type]
    if not (is_number(number) and number > 0):
        raise SettingError(f"{what} must be a positive finite number, got {_short(value)}")
    return number


def _short(value: object) -> str:
    """Return a value in one line."""
    text = " ".join(reprlib.repr(value).split())
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}... ({type(value).__name__})"


def peak_over_window(residuals: ArrayLike, window: int = 60) -> NDArray[np.float64]:
    r"""Return the largest norm of the residual over a moving window, the statistic of :class:`PeakThreshold`.

    .. math:: p(N) = \max_{N - window < k \le N} |r(k)|_2

    over the last ``window`` usable samples. A monitor with :class:`PeakThreshold` is in alarm at a sample if and only
    if this is over the threshold there, to the last bit, provided that the samples that it does not judge are NaN.
    The work does not grow with the window (van Herk's algorithm: the maxima from either end of blocks of one window).

    Parameters
    ----------
    residuals : array_like, shape (time, residuals) or (time,)
        NaN where a sample is not usable.
    window : int

    Returns
    -------
    ndarray, shape (time,)
        At a sample that is not usable that of the usable one before; NaN before the first of them.

    Raises
    ------
    DataError
        If the residuals are not one or two-dimensional.
    SettingError
        If the window is not a positive number of samples.

    References
    ----------
    Robust l1 fault detection, eq. (49); van Herk (1992), Pattern Recognition Letters 13(7), 517-521.

    Examples
    --------
    >>> from residua.decide import peak_over_window
    >>> peak_over_window([0.0, 3.0, float("nan"), -1.0, 2.0, 0.5], window=2)
    array([0., 3., 3., 3., 2., 2.])
    """
    check_samples(window, "window")
    rows = np.asarray(residuals, dtype=float)
    rows = rows[:, None] if rows.ndim == 1 else rows
    if rows.ndim != 2:
        raise DataError(f"residuals must be (time, residuals), got shape {rows.shape}")
    usable = ~np.isnan(rows).any(axis=1)
    peaks = _moving_maximum(row_norms(rows[usable]), int(window))
    seen = np.cumsum(usable)
    return np.concatenate([[np.nan], peaks])[seen]


def _moving_maximum(values: NDArray[np.float64], window: int) -> NDArray[np.float64]:
    """Return the largest of the last ``window`` values at each of them."""
    count = len(values)
    window = min(window, max(1, count))  # a longer one sees no more
    length = -(-(count + window - 1) // window) * window
    padded = np.full(length, -np.inf)
    padded[window - 1 : window - 1 + count] = values
    blocks = padded.reshape(-1, window)
    forwards = np.maximum.accumulate(blocks, axis=1).ravel()
    backwards = np.maximum.accumulate(blocks[:, ::-1], axis=1)[:, ::-1].ravel()
    return np.maximum(backwards[:count], forwards[window - 1 : window - 1 + count])


def peak_test(
    settings: PeakThreshold,
    thresholds: Sequence[float],
    basis: str,
    n_residuals: int,
    members: Parts | None = None,
) -> NormTest | BankTest:
    """Return the test with its thresholds: no centre, no whitening, raised by one sample and ended by ``window``.

    Parameters
    ----------
    settings : PeakThreshold
    thresholds : sequence of float
        One per member, or one.
    basis : str
        Where they come from, in words.
    n_residuals : int
    members : mapping of str to sequence of int, or sequence of sequence of int, optional
        Residual numbers of each member; when omitted, the residual is tested as a whole.
    """
    if members is None:
        return _blank(settings, n_residuals, thresholds[0], basis)
    tests = [_blank(settings, len(rows), J, basis) for rows, J in zip(rows_of(members), thresholds, strict=True)]
    return replace(side_by_side(tests, 1.0, members, n_residuals, PeakBankTest), basis=basis)


def _blank(settings: PeakThreshold, k: int, threshold: float = np.inf, basis: str = "") -> PeakTest:
    return PeakTest(np.zeros(k), np.eye(k), threshold, 1, settings.window, 1, basis)


def fit_peak_test(
    settings: PeakThreshold,
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    *,
    false_alarm_rate: float,
    signal_sizes: Sequence[float],
    members: Parts | None = None,
    seams: Sequence[int] = (),
) -> NormTest | BankTest:
    """Fit a threshold to the norm of fault-free residuals, or one to that of each member.

    As :func:`residua.decide.norm_threshold.fit_norm_test`, of the norm as it is: the fraction of usable samples in
    alarm, those of the window included, is to be ``false_alarm_rate``; each of ``M`` members gets ``1/M`` of it, or
    more where their alarms coincide (:func:`residua.decide.member_thresholds.fit_together`).

    Parameters
    ----------
    settings : PeakThreshold
    residuals : ndarray, shape (time, k)
    usable : ndarray of bool, shape (time,)
    false_alarm_rate : float
    signal_sizes : sequence of float
        For each member, or for the whole, the size of the signals that its residuals are the difference of.
    members : mapping of str to sequence of int, or sequence of sequence of int, optional
    seams : sequence of int
        The first sample of each further recording.

    Returns
    -------
    NormTest or BankTest

    Raises
    ------
    DataError
        If there are fewer usable samples than ten windows.
    """
    check_rate(false_alarm_rate)
    rows = [range(residuals.shape[1])] if members is None else rows_of(members)
    fits = [
        _observed(settings, residuals[:, list(part)], usable, size, seams)
        for part, size in zip(rows, signal_sizes, strict=True)
    ]
    if members is None:
        return with_threshold(fits[0], false_alarm_rate)
    return side_by_side(*fit_together(fits, false_alarm_rate), members, residuals.shape[1], PeakBankTest)


def _observed(
    settings: PeakThreshold,
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    signal_size: float,
    seams: Sequence[int],
) -> Fitted:
    count, least = int(usable.sum()), max(30, 10 * settings.window)
    if count < least:
        raise DataError(
            f"{count} usable samples are too few to fit {counted(residuals.shape[1], 'residual')} with a "
            f"window of {settings.window}: give at least {least} fault-free samples after the filter has settled"
        )
    norms = np.where(usable, row_norms(residuals), 0.0)
    data = FaultFree(residuals, usable, settings.window, tuple(seams))
    seen = observed(
        norms, data.full, usable, data.parts, np.inf, persistence=1, release=settings.window, window=settings.window
    )
    rounding = SIGNAL_ROUNDING * signal_size
    return Fitted(_blank(settings, residuals.shape[1]), seen, count, rounding if norms.max() <= rounding else None)


def checked_peak_test(
    test: NormTest | BankTest,
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    members: Sequence[str] = (),
    seams: Sequence[int] = (),
) -> NormTest | BankTest:
    """Check known thresholds against a fault-free recording; the basis then states the margin.

    Nothing is fitted: a threshold with a proof holds for every recording that its assumptions cover.

    Parameters
    ----------
    test : NormTest or BankTest
    residuals : ndarray, shape (time, k)
    usable : ndarray of bool, shape (time,)
    members : sequence of str
        Names of the members of a bank.
    seams : sequence of int
        The first sample of each further recording, if there are several in a row.

    Returns
    -------
    NormTest or BankTest

    Raises
    ------
    DataError
        If no sample is usable, or the recording goes over a threshold.
    """
    rows = residuals[usable]
    if not len(rows):
        raise DataError("no sample of this recording is usable, so it cannot be held against the thresholds")
    parts = [rows @ test.whitening[:, a:b] for a, b in test.columns] if isinstance(test, BankTest) else [rows]
    norms = np.array([row_norms(part) for part in parts]).T
    limits = test.thresholds if isinstance(test, BankTest) else np.array([test.threshold])
    samples, certified = np.flatnonzero(usable), test.basis.startswith(CERTIFIED)
    _check_below(norms, limits, samples, members, certified=certified, seams=seams)
    share = 100 * norms.max(axis=0) / limits
    if len(share) == 1:
        reach = f"{share[0]:.3g} % of it"
    elif len(share) <= _TOLD:
        reach = ", ".join(f"{s:.3g} % of that of {name}" for s, name in zip(share, members, strict=True))
    else:
        reach = f"at most {share.max():.3g} % of one, that of {members[int(share.argmax())]}"
    return replace(test, basis=f"{test.basis.split('; ')[0]}; {len(rows)} fault-free samples reached {reach}")


def _check_below(
    norms: NDArray[np.float64],
    limits: NDArray[np.float64],
    samples: NDArray[np.int64],
    members: Sequence[str],
    *,
    certified: bool,
    seams: Sequence[int],
) -> None:
    """Raise if a fault-free recording exceeds a threshold; ``norms``: (usable samples, members)."""
    worst = int((norms.max(axis=0) / limits).argmax())
    over = norms[:, worst] > limits[worst]
    if not over.any():
        return
    at = int(norms[:, worst].argmax())
    whose = f" of {members[worst]!r}" if members else ""
    count, where = int(over.sum()), told_sample(int(samples[at]), seams)
    excess = (
        f"this recording goes over the threshold{whose}: |r| = {norms[at, worst]:.4g} in {where}, "
        f"{norms[at, worst] / limits[worst]:.3g} times the threshold of {limits[worst]:.4g}, and over it in {count} of "
        f"{len(norms)} usable samples"
    )
    if certified:
        raise DataError(
            f"{excess}. The threshold is certified, so one of its assumptions does not hold: disturbances are larger "
            "than 1 in the units of the design, or the recording is in other units, or the plant lies outside the "
            "uncertainty set, or the recording has a fault in it, or the filter had not settled. Give a fault-free "
            "recording, or design for larger disturbances or a wider set"
        )
    raise DataError(
        f"{excess}. Give a fault-free recording, or higher thresholds; PeakThreshold() without thresholds fits them"
    )


__all__ = ["CERTIFIED", "GIVEN", "PeakBankTest", "PeakTest", "PeakThreshold", "peak_over_window"]
