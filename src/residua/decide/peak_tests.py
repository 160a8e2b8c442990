"""From the settings of a finite-horizon test to the test that runs: thresholds given, certified or fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from residua.decide.false_alarms import observed
from residua.decide.fault_free import FaultFree
from residua.decide.member_thresholds import BankTest, fit_together, side_by_side
from residua.decide.norm_threshold import Fitted, NormTest, check_rate, with_threshold
from residua.decide.peak_threshold import PeakThreshold
from residua.decide.row_norms import row_norms
from residua.decide.seams import told_sample
from residua.errors import DataError

#: How the basis of a test begins whose thresholds the design has certified, or the user has given.
CERTIFIED = "certified by the design over its uncertainty set"
GIVEN = "threshold given"

#: Members whose shares of their thresholds a basis tells one by one.
_TOLD = 8


def is_bound(test: NormTest | BankTest) -> bool:
    """Tell whether the thresholds of a test are bounds of the residual, certified or given, and not fitted to data."""
    return test.kind == "peak" and test.basis.startswith((CERTIFIED, GIVEN))


def peak_test(
    settings: PeakThreshold,
    thresholds: Sequence[float],
    basis: str,
    n_residuals: int,
    members: Sequence[Sequence[int]] | None = None,
) -> NormTest | BankTest:
    """Return the test with its thresholds: no centre, no whitening, one sample raises it and ``window`` end it.

    Parameters
    ----------
    settings : PeakThreshold
    thresholds : sequence of float
        One per member, or one.
    basis : str
        Where they come from, in words.
    n_residuals : int
    members : sequence of sequence of int, optional
        Residual numbers of each member; when omitted, the residual is tested as a whole.
    """
    if members is None:
        return _blank(settings, n_residuals, thresholds[0], basis)
    tests = [_blank(settings, len(rows), J, basis) for rows, J in zip(members, thresholds, strict=True)]
    return replace(side_by_side(tests, 1.0, members, n_residuals), basis=basis)


def _blank(settings: PeakThreshold, k: int, threshold: float = np.inf, basis: str = "") -> NormTest:
    return NormTest(np.zeros(k), np.eye(k), threshold, 1, settings.window, 1, basis, "peak")


def fit_peak_test(
    settings: PeakThreshold,
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    *,
    false_alarm_rate: float,
    signal_sizes: Sequence[float],
    members: Sequence[Sequence[int]] | None = None,
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
    members : sequence of sequence of int, optional
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
    rows = [range(residuals.shape[1])] if members is None else members
    found = [
        _observed(settings, residuals[:, list(part)], usable, size, seams)
        for part, size in zip(rows, signal_sizes, strict=True)
    ]
    if members is None:
        return with_threshold(found[0], false_alarm_rate)
    return side_by_side(*fit_together(found, false_alarm_rate), members, residuals.shape[1])


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
            f"{count} usable samples are too few to fit {residuals.shape[1]} residuals with a window of "
            f"{settings.window}: give at least {least} fault-free samples after the filter has settled"
        )
    norms = np.where(usable, row_norms(residuals), 0.0)
    data = FaultFree(residuals, usable, settings.window, tuple(seams))
    seen = observed(
        norms, data.full, usable, data.parts, np.inf, persistence=1, release=settings.window, window=settings.window
    )
    rounding = 1e-12 * signal_size
    return Fitted(_blank(settings, residuals.shape[1]), seen, count, rounding if norms.max() <= rounding else None)


def checked_peak_test(
    test: NormTest | BankTest,
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    members: Sequence[str] = (),
    seams: Sequence[int] = (),
) -> NormTest | BankTest:
    """Hold a test with known thresholds against a fault-free recording; its basis then tells how close that came.

    Nothing is fitted: a threshold with a proof holds for every recording that its assumptions cover.

    Parameters
    ----------
    test : NormTest or BankTest
    residuals : ndarray, shape (time, k)
    usable : ndarray of bool, shape (time,)
    members : sequence of str
        Names of the members of a bank.
    seams : sequence of int
        The first sample of each further recording, where there are several in a row.

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
        told = f"{share[0]:.3g} % of it"
    elif len(share) <= _TOLD:
        told = ", ".join(f"{s:.3g} % of that of {name}" for s, name in zip(share, members, strict=True))
    else:
        told = f"at most {share.max():.3g} % of one, that of {members[int(share.argmax())]}"
    return replace(test, basis=f"{test.basis.split('; ')[0]}; {len(rows)} fault-free samples reached {told}")


def _check_below(
    norms: NDArray[np.float64],
    limits: NDArray[np.float64],
    samples: NDArray[np.int64],
    members: Sequence[str],
    *,
    certified: bool,
    seams: Sequence[int],
) -> None:
    """Raise where a recording that is to be fault-free goes over a threshold; ``norms``: (usable samples, members)."""
    worst = int((norms.max(axis=0) / limits).argmax())
    over = norms[:, worst] > limits[worst]
    if not over.any():
        return
    at = int(norms[:, worst].argmax())
    whose = f" of {members[worst]!r}" if members else ""
    count, where = int(over.sum()), told_sample(int(samples[at]), seams)
    told = (
        f"this recording goes over the threshold{whose}: |r| = {norms[at, worst]:.4g} in {where}, "
        f"{norms[at, worst] / limits[worst]:.3g} times the threshold of {limits[worst]:.4g}, and over it in {count} of "
        f"{len(norms)} usable samples"
    )
    if certified:
        raise DataError(
            f"{told}. The threshold is certified, so one of its assumptions does not hold: disturbances are larger "
            "than 1 in the units of the design, or the recording is in other units, or the plant lies outside the "
            "uncertainty set, or the recording has a fault in it, or the filter had not settled. Give a fault-free "
            "recording, or design for larger disturbances or a wider set"
        )
    raise DataError(
        f"{told}. Give a fault-free recording, or higher thresholds; PeakThreshold() without thresholds fits them"
    )


__all__ = ["CERTIFIED", "GIVEN", "checked_peak_test", "fit_peak_test", "is_bound", "peak_test"]
