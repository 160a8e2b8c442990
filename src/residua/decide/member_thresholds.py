"""Thresholds for the parts of the residual that together keep the requested false alarm rate.

Parts are the members of a bank, or groups of residuals that users name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import check_rate, rate_aimed_at
from residua.decide.compiled import CompiledTest
from residua.decide.false_alarms import coincidence
from residua.decide.norm_fit import fit_norms, moments_of, whitening_of_sums
from residua.decide.persistence import AlarmRuns, alarm_logic
from residua.decide.row_norms import row_norms
from residua.decide.test import Block, FaultFreeRun, ResidualTest, Tested, Watched
from residua.decide.whitened_norm import (
    BAND_DEVIATIONS,
    BAND_SHARE,
    FITTED,
    RUNS,
    Fitted,
    NormSettings,
    NormState,
    NormTest,
    check_invertible,
    is_selection,
    leads_of_sums,
    norm_test_from_model,
    whitened_residuals,
    with_threshold,
)
from residua.decide.whitening import whitening_matrix
from residua.decide.window import empty_window, moving_sum
from residua.errors import FileFormatError, ModelError, SettingError
from residua.linear.systems.recursion import ordered_product
from residua.number_kinds import COUNT, ENTRY, POSITIVE, NumberKind

#: Groups of residuals: ``"each"`` by itself, names with the residuals of each, or none.
Groups = str | tuple[tuple[str, tuple[str, ...]], ...] | None
#: Residual numbers of each part, with or without names.
Parts = Mapping[str, Sequence[int]] | Sequence[Sequence[int]]


@dataclass(frozen=True, eq=False)
class BankTest(ResidualTest):
    """Fitted threshold tests of the members of a bank.

    Each member has its own whitening and threshold. The bank is in alarm while any member is.

    Attributes
    ----------
    center : ndarray, shape (k,)
        Fault-free mean of every residual.
    whitening : ndarray, shape (k, K)
        The members' whitening matrices side by side: ``(r - center) @ whitening`` are the whitened residuals of
        the first member, then those of the second, and so on.
    sizes : ndarray of int, shape (members,)
        How many of these columns belong to each member.
    thresholds : ndarray, shape (members,)
    persistence, release, window : int
    basis : str
        Where thresholds and covariances come from, in words.
    kind : {"norm", "peak"}
        As of ``NormTest``.
    promised, shrinkage : float or None
        As of ``NormTest``; of the whole bank, and the largest of the members.
    names : tuple of str
        Of the members.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {**RUNS, **FITTED, "sizes": COUNT, "thresholds": POSITIVE}

    center: NDArray[np.float64]
    whitening: NDArray[np.float64]
    sizes: NDArray[np.int64]
    thresholds: NDArray[np.float64]
    persistence: int
    release: int
    window: int
    basis: str
    kind: str = "norm"
    promised: float | None = None
    shrinkage: float | None = None
    names: tuple[str, ...] = ()

    @property
    def threshold(self) -> float:
        """One: the largest ratio of a member's statistic to its own threshold."""
        return 1.0

    @property
    def columns(self) -> list[tuple[int, int]]:
        """First and one past the last whitened column of each member."""
        ends = np.cumsum(self.sizes).tolist()
        return list(zip([0, *ends[:-1]], ends, strict=True))

    @property
    def band(self) -> NDArray[np.float64]:
        """Largest deviation of each residual alone, averaged over the window, below every threshold."""
        out = np.full(len(self.center), np.inf)
        for (start, stop), threshold in zip(self.columns, self.thresholds, strict=True):
            part = self.whitening[:, start:stop]
            rows = np.flatnonzero(np.any(part != 0, axis=1))
            inverse = np.linalg.pinv(part[rows])
            out[rows] = np.minimum(out[rows], threshold * np.sqrt(np.sum(inverse**2, axis=0) / self.window))
        return out

    def start(self, plants: int) -> NormState:
        """Return the state before the first sample."""
        window = empty_window(plants, self.window, self.whitening.shape[1])
        return NormState(window, AlarmRuns.empty(plants, len(self.sizes)))

    def run(self, state: NormState, block: Block) -> tuple[NormState, Tested]:
        """Compare the norm of each part, summed over the window, with its own threshold."""
        q, usable = whitened_residuals(self.center, self.whitening, block)
        sums, window = moving_sum(q, state.window, usable)
        statistics = np.full((*usable.shape, len(self.sizes)), np.nan)
        for m, (start, stop) in enumerate(self.columns):
            statistics[..., m] = np.where(usable, row_norms(sums[..., start:stop]) / np.sqrt(self.window), np.nan)
        over = usable[..., None] & (np.where(usable[..., None], statistics, 0.0) > self.thresholds)
        runs = state.runs
        fired, up, down = member_alarms(self, over, usable, runs.up, runs.down, runs.alarm)
        if usable.shape[1]:
            runs = AlarmRuns.after(up, down, fired)
        tested = Tested(
            usable,
            np.max(statistics / self.thresholds, axis=2),
            np.asarray(over.any(axis=2)),
            np.asarray(fired.any(axis=2)),
            np.where(fired, up, 0).max(axis=2, initial=0),
            self._whole(q, usable, block),
            statistics,
            fired,
        )
        return NormState(window, runs), tested

    def _whole(self, q: NDArray, usable: NDArray[np.bool_], block: Block) -> NDArray[np.float64]:
        """Return the residual in units in which its direction is judged: none for a bank."""
        return q

    @property
    def compiled(self) -> CompiledTest | None:
        """Equivalent for the fused loop."""
        return self._in_c() if type(self) is BankTest else None

    def _in_c(self, joint: NDArray[np.float64] | None = None) -> CompiledTest:
        return CompiledTest(
            "parts",
            self.center,
            self.whitening,
            self.threshold,
            self.window,
            self.persistence,
            self.release,
            sizes=self.sizes,
            limits=self.thresholds,
            joint=joint,
        )

    # ----------------------------------------------- interface to the rest of a monitor

    @property
    def samples(self) -> int:
        """Number of samples in the sum."""
        return self.window

    @property
    def metric(self) -> NDArray[np.float64]:
        """Whitening matrix."""
        return self.whitening

    @property
    def per_deviation(self) -> NDArray[np.float64] | None:
        """Whitening matrix."""
        return self.whitening

    @property
    def per_threshold(self) -> NDArray[np.float64]:
        """Whitening matrix in units of the thresholds."""
        return self.whitening / np.repeat(self.thresholds, self.sizes)

    @property
    def guarded(self) -> NDArray[np.float64]:
        """Weights in standard deviations."""
        return np.abs(self.whitening)

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of the members."""
        return self.names

    @property
    def part_thresholds(self) -> NDArray[np.float64]:
        """Thresholds of the members."""
        return self.thresholds

    def leads(
        self, residuals: NDArray[np.float64], changes: NDArray[np.float64], signals: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """Return the responses of the parts to faults of size one, relative to the thresholds; ``None`` for peaks."""
        if type(self) not in (BankTest, GroupTest):
            return None
        white = residuals @ self.whitening
        parts = zip(self.columns, self.thresholds.tolist(), strict=True)
        return np.max([leads_of_sums(white[..., a:b], self.window, limit) for (a, b), limit in parts], axis=0)

    def bands(self) -> tuple[NDArray[np.float64], float]:
        """Return the band of each residual alone; see :meth:`NormTest.bands`."""
        if is_selection(self.whitening):
            return self.band, 0.0
        return BAND_DEVIATIONS * replace(self, thresholds=np.ones(len(self.thresholds))).band, BAND_SHARE

    def words(self, step: float) -> dict[str, str]:
        """Describe the thresholds, the statistic, and the start and end of an alarm."""
        summed = f", summed over {self.window} samples" if self.window > 1 else ""
        return {
            "threshold": self._limits(),
            "test": f"norm of each {self._whose}{summed}; the statistic is the largest ratio to its threshold",
            "alarm": self._raised(f"{self.persistence} samples in a row"),
        }

    #: A part of it, that part and all of them, in words.
    _whose: ClassVar[str] = "member's whitened residual"
    _part: ClassVar[str] = "member"
    _all: ClassVar[str] = "the bank"

    def _limits(self) -> str:
        limits = ", ".join(f"{name} {limit:.4g}" for name, limit in zip(self.names, self.thresholds, strict=True))
        return f"{limits} ({self.basis})"

    def _raised(self, samples: str) -> str:
        return (
            f"of a {self._part}: raised by {samples} over its threshold, ended by {self.release} below it; "
            f"of {self._all}: while any {self._part} is in alarm"
        )

    # --------------------------------------------------------------------------- files

    def check(self, watched: Watched) -> None:
        """Raise if a test from a file does not fit the watched generator."""
        k, parts = watched.generator.n_residuals, self._parts_of(watched)
        sizes = [len(rows) for rows in parts.values()]
        if self.names != tuple(parts):
            raise FileFormatError(f"fitted: names must be those of the {self._part}s")
        if self.sizes.tolist() != sizes or self.thresholds.shape != (len(sizes),):
            raise FileFormatError(f"fitted: sizes and thresholds must be for {len(sizes)} members")
        if self.center.shape != (k,) or self.whitening.shape != (k, sum(sizes)):
            raise FileFormatError(f"fitted: center and whitening must be for {k} residuals")
        for start, stop in self.columns:
            check_invertible(self.whitening[:, start:stop], of_some=True)

    def _parts_of(self, watched: Watched) -> Mapping[str, Sequence[int]]:
        return watched.parts or {}

    def check_state(self, state: NormState) -> None:
        """Raise if a state from a file is invalid."""
        state.window.check("state.test.window")


def bank_test_from_model(
    settings: NormSettings, covariance: NDArray | None, members: Parts, n_residuals: int
) -> BankTest | None:
    """Return the test that needs no data, or ``None`` when data are needed; see :func:`fit_bank_test`."""
    single = replace(settings, false_alarm_rate=rate_aimed_at(settings.false_alarm_rate) / max(1, len(members)))
    tests = [norm_test_from_model(single, _part(covariance, rows), len(rows)) for rows in rows_of(members)]
    present = [test for test in tests if test is not None]
    return side_by_side(present, 1.0, members, n_residuals) if present and len(present) == len(tests) else None


def fit_bank_test(
    settings: NormSettings, run: FaultFreeRun, members: Parts, rate: float, covariance: NDArray | None
) -> BankTest:
    """Fit mean, covariance and threshold of every member to fault-free residuals; see :func:`fit_norms`.

    Parameters
    ----------
    settings : NormSettings
    run : FaultFreeRun
    members : mapping of str to sequence of int, or sequence of sequence of int
        Residual numbers of each member.
    rate : float
        Fraction of samples in which any member is in alarm.
    covariance : ndarray or None
        From the plant's noise model, of sums over the window.

    Returns
    -------
    BankTest
    """
    check_rate(rate)
    rows = rows_of(members)
    covariances = [_part(covariance, one) for one in rows]
    tests = fit_norms(settings, run, rows, rate, covariances)
    if tests is None:
        fits = moments_of(settings, run, rows, covariances)
        return side_by_side(*fit_together(fits, rate), members, run.residuals.shape[1])
    bank = side_by_side(tests, 1.0, members, run.residuals.shape[1])
    if settings.threshold is not None:
        return bank
    bases = list(dict.fromkeys(test.basis for test in tests))
    listed = bases if len(bases) <= _TOLD else [*bases[:_TOLD], f"and {len(bases) - _TOLD} more"]
    basis = f"{' / '.join(listed)}; of the whole bank, with the same rate for each of {len(tests)} members"
    return replace(bank, basis=basis, promised=tests[0].promised)


#: Members in alarm at once, on average, from which on that is made use of.
_NOTABLE = 1.05


def fit_together(fits: Sequence[Fitted], rate: float) -> tuple[list[NormTest], float]:
    """Return the tests of members that keep a rate together, and the mean number of them in alarm at once.

    The fraction of samples in which any of ``M`` members is in alarm is the sum of theirs, divided by how many are in
    alarm at once on average, ``c``: each gets a rate of ``c / M`` of the whole. Where the data do not show ``c`` it is
    taken as 1, which is right for any correlation between members (the union bound).
    """
    seen = [one.seen for one in fits if one.seen is not None]
    at_once = coincidence(seen, rate / len(fits)) if len(seen) == len(fits) > 1 else 1.0
    at_once = min(at_once, float(len(fits))) if at_once > _NOTABLE else 1.0
    return [with_threshold(one, rate * at_once / len(fits)) for one in fits], at_once


def rows_of(members: Parts) -> list[Sequence[int]]:
    """Return the residual numbers of each part."""
    return list(members.values()) if isinstance(members, Mapping) else list(members)


def _part(covariance: NDArray | None, rows: Sequence[int]) -> NDArray | None:
    if not len(rows):
        raise ModelError("a member of this bank has no residuals")
    return None if covariance is None else covariance[np.ix_(list(rows), list(rows))]


def side_by_side(
    tests: Sequence[NormTest], at_once: float, members: Parts, n_residuals: int, makes: type[BankTest] | None = None
) -> BankTest:
    """Return the tests of the members as one.

    ``members`` are the residual numbers of each, ``at_once`` is how many are in alarm at once.
    """
    places = rows_of(members)
    sizes = np.array([len(rows) for rows in places], dtype=np.int64)
    center, whitening, at = np.zeros(n_residuals), np.zeros((n_residuals, int(sizes.sum()))), 0
    for test, rows in zip(tests, places, strict=True):
        center[list(rows)] = test.center
        whitening[list(rows), at : at + len(rows)] = test.whitening
        at += len(rows)
    one = tests[0]
    promises = [test.promised for test in tests if test.promised is not None]
    promised = float(min(1.0, sum(promises) / at_once)) if len(promises) == len(tests) else None
    drawn = [test.shrinkage for test in tests if test.shrinkage is not None]
    return (makes or BankTest)(
        center,
        whitening,
        sizes,
        np.array([test.threshold for test in tests]),
        one.persistence,
        one.release,
        one.window,
        _basis(tests, at_once),
        one.kind,
        promised,
        float(max(drawn)) if drawn else None,
        tuple(members) if isinstance(members, Mapping) else tuple(str(k + 1) for k in range(len(members))),
    )


def _basis(tests: Sequence[NormTest], at_once: float) -> str:
    """Describe the origin of the thresholds of the members."""
    bases = list(dict.fromkeys(test.basis for test in tests))
    count = len(tests)
    if count == 1:
        return bases[0]
    listed = bases if len(bases) <= _TOLD else [*bases[:_TOLD], f"and {len(bases) - _TOLD} more"]
    basis = f"each of {count} members: {' / '.join(listed)}"
    if bases[0].startswith("threshold given"):
        return basis
    if at_once > 1:
        return (
            f"{basis}; that is {at_once:.3g}/{count} of the rate of the whole bank, for {at_once:.3g} are in alarm at "
            "once"
        )
    return f"{basis}; that is 1/{count} of the rate of the whole bank"


#: Members whose bases are listed one by one.
_TOLD = 3


def member_alarms(
    test: BankTest,
    exceeded: NDArray[np.bool_],
    usable: NDArray[np.bool_],
    up: NDArray[np.integer],
    down: NDArray[np.integer],
    alarm: NDArray[np.bool_],
) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64]]:
    """Run the alarm logic of every member; see :func:`residua.decide.persistence.alarm_logic`.

    Parameters
    ----------
    test : BankTest
    exceeded : ndarray of bool, shape (plants, time, members)
    usable : ndarray of bool, shape (plants, time)
    up, down, alarm : ndarray, shape (plants, members)

    Returns
    -------
    alarm, up, down : ndarray, shape (plants, time, members)
    """
    plants, time, count = exceeded.shape
    rows = exceeded.transpose(0, 2, 1).reshape(plants * count, time)
    on, ups, downs = alarm_logic(
        rows,
        np.repeat(usable, count, axis=0),
        up.ravel(),
        down.ravel(),
        alarm.ravel(),
        test.persistence,
        test.release,
    )
    shape = (plants, count, time)
    return tuple(part.reshape(shape).transpose(0, 2, 1) for part in (on, ups, downs))  # pyright: ignore


@dataclass(frozen=True, eq=False)
class GroupTest(BankTest):
    """Fitted threshold tests of groups of residuals.

    As :class:`BankTest`, with the groups as its members; the direction of the residual is that of all of it.

    Attributes
    ----------
    whole : ndarray, shape (k, k)
        Whitening of all residuals together, in which direction is judged.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {**BankTest.NUMBER_KINDS, "whole": ENTRY}

    whole: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))

    _whose: ClassVar[str] = "group of residuals, whitened"
    _part: ClassVar[str] = "group"
    _all: ClassVar[str] = "all"

    def _whole(self, q: NDArray, usable: NDArray[np.bool_], block: Block) -> NDArray[np.float64]:
        return ordered_product(np.where(usable[..., None], block.residuals - self.center, 0.0), self.whole)

    @property
    def compiled(self) -> CompiledTest | None:
        """Equivalent for the fused loop."""
        same = self.whole.shape == self.whitening.shape
        return self._in_c(self.whole) if type(self) is GroupTest and same else None

    @property
    def metric(self) -> NDArray[np.float64]:
        """Whitening of all residuals together."""
        return self.whole

    @property
    def groups_of_residuals(self) -> dict[str, tuple[int, ...]]:
        """Residual numbers of each group."""
        seen = ((name, np.any(self.whitening[:, a:b] != 0, axis=1)) for name, (a, b) in
                zip(self.names, self.columns, strict=True))  # fmt: skip
        return {name: tuple(np.flatnonzero(rows).tolist()) for name, rows in seen}

    def check(self, watched: Watched) -> None:
        """Raise if a test from a file does not fit the watched generator."""
        super().check(watched)
        k = watched.generator.n_residuals
        if self.whole.shape != (k, k):
            raise FileFormatError(f"fitted: names must be those of the groups, and whole be for {k} residuals")


def rows_of_groups(groups: Groups, residuals: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Return the residual numbers of each group.

    Raises
    ------
    SettingError
        If the groups do not have each residual just once.
    """
    if groups == "each":
        return {name: (i,) for i, name in enumerate(residuals)}
    assert not isinstance(groups, str)
    places = {name: i for i, name in enumerate(residuals)}
    grouped = [name for _, members in groups or () for name in members]
    unknown = [name for name in grouped if name not in places]
    twice = sorted({name for name in grouped if grouped.count(name) > 1})
    missing = [name for name in residuals if name not in grouped]
    if unknown or twice or missing:
        reasons = "; ".join(
            f"{what} {', '.join(map(repr, names[:5]))}"
            for what, names in (("unknown:", unknown), ("in two groups:", twice), ("in none:", missing))
            if names
        )
        raise SettingError(
            f"groups must have every residual of the generator just once ({', '.join(map(repr, residuals[:8]))}"
            f"{', ...' if len(residuals) > 8 else ''}); {reasons}"
        )
    return {name: tuple(places[one] for one in members) for name, members in groups or ()}


def group_test_from_model(
    settings: NormSettings, covariance: NDArray | None, rows: Mapping[str, Sequence[int]], n_residuals: int
) -> GroupTest | None:
    """Return the test that needs no data, or ``None`` when data are needed; each group gets 1/G of the rate."""
    test = bank_test_from_model(settings, covariance, rows, n_residuals)
    if test is None:
        return None
    known = covariance is not None and settings.whiten in ("auto", "model")
    whole = whitening_matrix(covariance) if known and covariance is not None else np.eye(n_residuals)
    return _with_names(test, rows, whole)


def fit_group_test(
    settings: NormSettings,
    run: FaultFreeRun,
    rows: Mapping[str, Sequence[int]],
    rate: float,
    covariance: NDArray | None,
) -> GroupTest:
    """Fit the tests of all groups to fault-free residuals, as :func:`fit_bank_test` does for members."""
    test = fit_bank_test(settings, run, rows, rate, covariance)
    return _with_names(test, rows, whitening_of_sums(settings, run, covariance))


def _with_names(test: BankTest, rows: Mapping[str, Sequence[int]], whole: NDArray[np.float64]) -> GroupTest:
    values = {one.name: getattr(test, one.name) for one in fields(BankTest)}
    values["basis"] = test.basis.replace(" members", " groups", 1).replace("of the whole bank", "of all together")
    return GroupTest(**values, whole=whole)
