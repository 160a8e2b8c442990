"""Thresholds fitted to a fault-free recording."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from residua.decide.matched import Matched
from residua.decide.matched_level import fit_matched_test
from residua.decide.member_thresholds import BankTest, fit_bank_test
from residua.decide.norm_threshold import NormTest, fit_norm_test
from residua.decide.peak_threshold import PeakThreshold
from residua.decide.structured import Structured
from residua.design import ResidualGenerator
from residua.errors import DataError
from residua.monitor.filtering import plausible_values
from residua.monitor.inputs import settling_reason, settling_samples, signal_size
from residua.monitor.peak_preparing import Threshold, first_peak_test, fitted_peak_test, member_rows
from residua.monitor.preparing import Isolation, blank_test, responses_of, specification
from residua.monitor.running import initial_state, run_block


def fitted_test(
    settings: Threshold,
    certified: Mapping[str, float],
    isolate: Isolation,
    generator: ResidualGenerator,
    data: NDArray[np.float64],
    rate: float,
    *,
    settle: int | None,
    max_hold: int,
    plausible: NDArray[np.float64],
    start: str,
) -> NormTest | BankTest:
    """Return the test fitted to a fault-free recording, shape (1, time, channels), in plant units."""
    if len(data) != 1:
        raise DataError("fit takes one recording, (time, channels)")
    outputs = data[0, :, len(generator.plant.inputs) :]
    if len(outputs) > 1 and not np.nanmax(np.ptp(np.where(np.isfinite(outputs), outputs, 0.0), axis=0)) > 0:
        raise DataError("no output ever changes in this recording: it cannot show what is normal")
    if isinstance(settings, PeakThreshold):  # known thresholds want a longer wait, and hold from rest
        known = first_peak_test(settings, certified, generator, by_code=isinstance(isolate, Structured))
        settle = settling_samples(generator, known) if settle is None else settle
        start = start if known is None else "rest"
    given = {"settle": settle, "max_hold": max_hold, "plausible": plausible, "start": start}
    blank = specification(generator, blank_test(generator), None, **given)
    deviations, _, _ = plausible_values(blank, data)
    _, found = run_block(blank, initial_state(blank, 1), data)
    try:
        return _fitted(
            settings, certified, isolate, generator, found.residuals[0], found.usable[0], deviations[0], rate
        )
    except DataError as error:
        if 2 * blank.settle < len(outputs):
            raise
        raise DataError(f"{error}; {settling_reason(generator, blank.settle)}") from error


def _fitted(
    settings: Threshold,
    certified: Mapping[str, float],
    isolate: Isolation,
    generator: ResidualGenerator,
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    deviations: NDArray[np.float64],
    rate: float,
) -> NormTest | BankTest:
    """Return the test fitted to fault-free residuals; ``deviations`` are the signals that they were made from."""
    by_code = isinstance(isolate, Structured)
    if isinstance(settings, PeakThreshold):
        return fitted_peak_test(settings, certified, generator, residuals, usable, deviations, rate, by_code=by_code)
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
        )
    return fit_norm_test(
        settings,
        residuals,
        usable,
        false_alarm_rate=rate,
        covariance=covariance,
        signal_size=signal_size(generator, deviations),
    )
