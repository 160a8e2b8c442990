"""One threshold test per member of a bank, so that the whole bank keeps the false alarm rate asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua.decide.norm_threshold import NormTest, NormThreshold, check_rate, fit_norm_test, norm_test_from_model
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
    return side_by_side(found, members, n_residuals) if found and len(found) == len(tests) else None


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

    Each of ``M`` members gets a rate of ``false_alarm_rate / M``: the fraction of samples in which any of them is
    in alarm is at most the sum of theirs, whatever the correlation between them (the union bound). Members whose
    alarms coincide stay below what was asked for, by ``M`` times at most.

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
        The first sample of each further recording, where there are several in a row.

    Returns
    -------
    BankTest
    """
    check_rate(false_alarm_rate)
    tests = [
        fit_norm_test(
            settings,
            residuals[:, list(rows)],
            usable,
            false_alarm_rate=false_alarm_rate / len(members),
            covariance=_part(covariance, rows),
            signal_size=size,
            seams=seams,
        )
        for rows, size in zip(members, signal_sizes, strict=True)
    ]
    return side_by_side(tests, members, residuals.shape[1])


def _part(covariance: NDArray | None, rows: Sequence[int]) -> NDArray | None:
    if not len(rows):
        raise ModelError("a member of this bank has no residuals")
    return None if covariance is None else covariance[np.ix_(list(rows), list(rows))]


def side_by_side(tests: Sequence[NormTest], members: Sequence[Sequence[int]], n_residuals: int) -> BankTest:
    """Return the tests of the members as one; ``members`` are the residual numbers of each."""
    sizes = np.array([len(rows) for rows in members], dtype=np.int64)
    center, whitening, at = np.zeros(n_residuals), np.zeros((n_residuals, int(sizes.sum()))), 0
    for test, rows in zip(tests, members, strict=True):
        center[list(rows)] = test.center
        whitening[list(rows), at : at + len(rows)] = test.whitening
        at += len(rows)
    bases = list(dict.fromkeys(test.basis for test in tests))
    basis = " / ".join(bases) if len(tests) == 1 else f"each of {len(tests)} members: {' / '.join(bases)}"
    if len(tests) > 1 and not bases[0].startswith("threshold given"):
        basis += f"; that is 1/{len(tests)} of the rate of the whole bank"
    one = tests[0]
    thresholds = np.array([test.threshold for test in tests])
    return BankTest(center, whitening, sizes, thresholds, one.persistence, one.release, one.window, basis, one.kind)


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
