"""Thresholds fitted to fault-free recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua.decide.matched import Matched
from residua.decide.matched_level import fit_matched_test
from residua.decide.member_thresholds import BankTest, fit_bank_test
from residua.decide.norm_threshold import NormTest, fit_norm_test
from residua.decide.peak_threshold import PeakThreshold
from residua.decide.residual_groups import fit_group_test, rows_of_groups
from residua.decide.structured import Structured
from residua.design import ResidualGenerator
from residua.errors import DataError
from residua.monitor.filtering import plausible_values
from residua.monitor.inputs import settling_reason, settling_samples, signal_size
from residua.monitor.peak_preparing import Threshold, first_peak_test, fitted_peak_test, member_rows
from residua.monitor.preparing import Isolation, blank_test, responses_of, specification
from residua.monitor.running import Specification, initial_state, run_block


@dataclass(frozen=True, eq=False)
class FaultFreeRun:
    """What a generator makes of fault-free recordings, one after the other.

    Attributes
    ----------
    residuals : ndarray, shape (time, k)
    usable : ndarray of bool, shape (time,)
        Not while a filter settles: each recording has its own start.
    deviations : ndarray, shape (time, channels)
        The signals that the residuals were made from.
    seams : tuple of int
        The first sample of each further recording: nothing goes across.
    """

    residuals: NDArray[np.float64]
    usable: NDArray[np.bool_]
    deviations: NDArray[np.float64]
    seams: tuple[int, ...]


def fitted_test(
    settings: Threshold,
    certified: Mapping[str, float],
    isolate: Isolation,
    generator: ResidualGenerator,
    recordings: Sequence[NDArray[np.float64]],
    rate: float,
    *,
    settle: int | None,
    max_hold: int,
    plausible: NDArray[np.float64],
    start: str,
) -> NormTest | BankTest:
    """Return the test fitted to fault-free recordings, each of shape (1, time, channels), in plant units."""
    _check_recordings(recordings, len(generator.plant.inputs))
    if isinstance(settings, PeakThreshold):  # known thresholds want a longer wait, and hold from rest
        known = first_peak_test(settings, certified, generator, by_code=isinstance(isolate, Structured))
        settle = settling_samples(generator, known) if settle is None else settle
        start = start if known is None else "rest"
    given = {"settle": settle, "max_hold": max_hold, "plausible": plausible, "start": start}
    blank = specification(generator, blank_test(generator), None, **given)
    found = _run(blank, recordings, settling_reason(generator, blank.settle))
    try:
        test = _fitted(settings, certified, isolate, generator, found, rate)
    except DataError as error:
        if 2 * blank.settle * len(recordings) < len(found.usable):
            raise
        raise DataError(f"{error}; {settling_reason(generator, blank.settle)}") from error
    if len(recordings) == 1:
        return test
    return replace(test, basis=f"{test.basis}; {len(recordings)} recordings, each from its own start")


def _check_recordings(recordings: Sequence[NDArray[np.float64]], n_inputs: int) -> None:
    for number, data in enumerate(recordings, 1):
        which = f"recording {number} of {len(recordings)}" if len(recordings) > 1 else "this recording"
        if len(data) != 1:
            raise DataError(f"{which} has the shape (plants, time, channels): fit takes (time, channels), or several")
        outputs = data[0, :, n_inputs:]
        if len(outputs) > 1 and not np.nanmax(np.ptp(np.where(np.isfinite(outputs), outputs, 0.0), axis=0)) > 0:
            raise DataError(f"no output ever changes in {which}: it cannot show what is normal")


def _run(blank: Specification, recordings: Sequence[NDArray[np.float64]], reason: str) -> FaultFreeRun:
    """Run over each recording from a start of its own."""
    found = [run_block(blank, initial_state(blank, 1), data)[1] for data in recordings]
    if len(recordings) > 1:
        for number, (one, data) in enumerate(zip(found, recordings, strict=True), 1):
            if not one.usable.any():
                raise DataError(
                    f"recording {number} of {len(recordings)} has no usable sample: {data.shape[1]} samples, {reason}; "
                    "leave it out"
                )
    return FaultFreeRun(
        np.concatenate([one.residuals[0] for one in found]),
        np.concatenate([one.usable[0] for one in found]),
        np.concatenate([plausible_values(blank, data)[0][0] for data in recordings]),
        tuple(int(k) for k in np.cumsum([data.shape[1] for data in recordings[:-1]])),
    )


def _fitted(
    settings: Threshold,
    certified: Mapping[str, float],
    isolate: Isolation,
    generator: ResidualGenerator,
    run: FaultFreeRun,
    rate: float,
) -> NormTest | BankTest:
    """Return the test fitted to fault-free residuals."""
    residuals, usable, deviations, seams = run.residuals, run.usable, run.deviations, run.seams
    by_code = isinstance(isolate, Structured)
    if isinstance(settings, PeakThreshold):
        return fitted_peak_test(
            settings, certified, generator, residuals, usable, deviations, rate, by_code=by_code, seams=seams
        )
    covariance = generator.covariance_of_sums(settings.window)
    if by_code:
        rows = member_rows(generator)
        return fit_bank_test(
            settings,
            residuals,
            usable,
            rows,
            false_alarm_rate=rate,
            covariance=covariance,
            signal_sizes=[signal_size(generator, deviations, part) for part in rows],
            seams=seams,
        )
    if isinstance(isolate, Matched):
        return fit_matched_test(
            settings,
            residuals,
            usable,
            lambda w: responses_of(generator, isolate, w),
            false_alarm_rate=rate,
            covariance=covariance,
            signal_size=signal_size(generator, deviations),
            seams=seams,
        )
    if settings.groups is not None:
        groups = rows_of_groups(settings.groups, generator.residuals)
        return fit_group_test(
            settings,
            residuals,
            usable,
            groups,
            false_alarm_rate=rate,
            covariance=covariance,
            signal_sizes=[signal_size(generator, deviations, part) for part in groups.values()],
            seams=seams,
        )
    return fit_norm_test(
        settings,
        residuals,
        usable,
        false_alarm_rate=rate,
        covariance=covariance,
        signal_size=signal_size(generator, deviations),
        seams=seams,
    )
