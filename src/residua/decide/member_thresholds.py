"""One threshold test per member of a bank, so that the whole bank keeps the false alarm rate asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua.decide.false_alarms import coincidence
from residua.decide.norm_threshold import (
    Fitted,
    NormTest,
    NormThreshold,
    check_rate,
    fit_moments,
    norm_test_from_model,
    with_threshold,
)
from residua.decide.persistence import alarm_logic
from residua.errors import ModelError


@dataclass(frozen=True, eq=False)
class BankTest:
    """The threshold tests of the members of a bank, every number filled in: what runs.

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
        As of :class:`residua.decide.NormTest`.
    promised, shrinkage : float or None
        As of :class:`residua.decide.NormTest`; of the whole bank, and the largest of the members.
    """

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

    @property
    def threshold(self) -> float:
        """1: that of the largest ratio of a member's statistic to its own threshold."""
        return 1.0

    @property
    def columns(self) -> list[tuple[int, int]]:
        """First and one past the last whitened column of each member."""
        ends = np.cumsum(self.sizes).tolist()
        return list(zip([0, *ends[:-1]], ends, strict=True))

    @property
    def band(self) -> NDArray[np.float64]:
        """How far each residual alone, averaged over the window, can be from its mean below every threshold."""
        out = np.full(len(self.center), np.inf)
        for (start, stop), threshold in zip(self.columns, self.thresholds, strict=True):
            part = self.whitening[:, start:stop]
            rows = np.flatnonzero(np.any(part != 0, axis=1))
            inverse = np.linalg.pinv(part[rows])
            out[rows] = np.minimum(out[rows], threshold * np.sqrt(np.sum(inverse**2, axis=0) / self.window))
        return out


def bank_test_from_model(
    settings: NormThreshold, covariance: NDArray | None, members: Sequence[Sequence[int]], n_residuals: int
) -> BankTest | None:
    """Return the test that needs no data, or ``None`` when data are needed; see :func:`fit_bank_test`."""
    single = replace(settings, false_alarm_rate=settings.false_alarm_rate / max(1, len(members)))
    tests = [norm_test_from_model(single, _part(covariance, rows), len(rows)) for rows in members]
    found = [test for test in tests if test is not None]
    return side_by_side(found, 1.0, members, n_residuals) if found and len(found) == len(tests) else None


def fit_bank_test(
    settings: NormThreshold,
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    members: Sequence[Sequence[int]],
    *,
    false_alarm_rate: float,
    covariance: NDArray | None,
    signal_sizes: Sequence[float],
    seams: Sequence[int] = (),
) -> BankTest:
    """Fit mean, covariance and threshold of every member to fault-free residuals.

    Every member gets the same share of the rate; see :func:`fit_together`.

    Parameters
    ----------
    settings : NormThreshold
    residuals : ndarray, shape (time, k)
    usable : ndarray of bool, shape (time,)
    members : sequence of sequence of int
        Residual numbers of each member.
    false_alarm_rate : float
        Of the whole bank.
    covariance : ndarray or None
        From the plant's noise model, of sums over the window.
    signal_sizes : sequence of float
        For each member the size of the signals that its residuals are the difference of.
    seams : sequence of int
        The first sample of each further recording.

    Returns
    -------
    BankTest
    """
    check_rate(false_alarm_rate)
    found = [
        fit_moments(
            settings,
            residuals[:, list(rows)],
            usable,
            covariance=_part(covariance, rows),
            signal_size=size,
            seams=seams,
        )
        for rows, size in zip(members, signal_sizes, strict=True)
    ]
    return side_by_side(*fit_together(found, false_alarm_rate), members, residuals.shape[1])


#: Members in alarm at once, on average, from which on that is made use of.
_NOTABLE = 1.05


def fit_together(found: Sequence[Fitted], rate: float) -> tuple[list[NormTest], float]:
    """Return the tests of members that keep a rate together, and how many of them are in alarm at once.

    The fraction of samples in which any of ``M`` members is in alarm is the sum of theirs, divided by how many are in
    alarm at once on average, ``c``: each gets a rate of ``c / M`` of the whole. Where the data do not show ``c`` it is
    taken as 1, which is right for any correlation between members (the union bound).
    """
    seen = [one.seen for one in found if one.seen is not None]
    at_once = coincidence(seen, rate / len(found)) if len(seen) == len(found) > 1 else 1.0
    at_once = min(at_once, float(len(found))) if at_once > _NOTABLE else 1.0
    return [with_threshold(one, rate * at_once / len(found)) for one in found], at_once


def _part(covariance: NDArray | None, rows: Sequence[int]) -> NDArray | None:
    if not len(rows):
        raise ModelError("a member of this bank has no residuals")
    return None if covariance is None else covariance[np.ix_(list(rows), list(rows))]


def side_by_side(
    tests: Sequence[NormTest], at_once: float, members: Sequence[Sequence[int]], n_residuals: int
) -> BankTest:
    """Return the tests of the members as one.

    ``members`` are the residual numbers of each, ``at_once`` is how many are in alarm at once.
    """
    sizes = np.array([len(rows) for rows in members], dtype=np.int64)
    center, whitening, at = np.zeros(n_residuals), np.zeros((n_residuals, int(sizes.sum()))), 0
    for test, rows in zip(tests, members, strict=True):
        center[list(rows)] = test.center
        whitening[list(rows), at : at + len(rows)] = test.whitening
        at += len(rows)
    one = tests[0]
    promises = [test.promised for test in tests if test.promised is not None]
    promised = float(min(1.0, sum(promises) / at_once)) if len(promises) == len(tests) else None
    drawn = [test.shrinkage for test in tests if test.shrinkage is not None]
    return BankTest(
        center,
        whitening,
        sizes,
        np.array([test.threshold for test in tests]),
        one.persistence,
        one.release,
        one.window,
        _basis(tests, at_once, promised),
        one.kind,
        promised,
        float(max(drawn)) if drawn else None,
    )


def _basis(tests: Sequence[NormTest], at_once: float, promised: float | None) -> str:
    """Return where the thresholds of the members come from, in words."""
    bases = list(dict.fromkeys(test.basis for test in tests))
    count = len(tests)
    if count == 1:
        return bases[0]
    told = bases if len(bases) <= _TOLD else [*bases[:_TOLD], f"and {len(bases) - _TOLD} more"]
    basis = f"each of {count} members: {' / '.join(told)}"
    if bases[0].startswith("threshold given"):
        return basis
    if at_once > 1:
        basis += (
            f"; that is {at_once:.3g}/{count} of the rate of the whole bank, for {at_once:.3g} are in alarm at once"
        )
    else:
        basis += f"; that is 1/{count} of the rate of the whole bank"
    if promised is not None:
        sure = f"at most {promised:.2g} with 95 % confidence" if promised < 1 else "which these data cannot promise"
        basis += f", {sure}"
    return basis


#: Members whose bases are told one by one.
_TOLD = 3


def member_alarms(
    test: BankTest,
    exceeded: NDArray[np.bool_],
    usable: NDArray[np.bool_],
    up: NDArray[np.int64],
    down: NDArray[np.int64],
    alarm: NDArray[np.bool_],
) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64]]:
    """Run the alarm logic of every member; as :func:`residua.decide.persistence.alarm_logic`, with an axis more.

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
