"""Thresholds fitted to fault-free recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from residua.decide.isolation import NoIsolation
from residua.decide.test import FaultFreeRun, ResidualTest, TestSettings, Watched
from residua.errors import DataError
from residua.monitor.filtering import plausible_values
from residua.monitor.inputs import settling_reason, settling_samples, signal_levels
from residua.monitor.running import initial_state, run_block
from residua.monitor.setup import blank_test, specification
from residua.monitor.specification import Specification


def fitted_test(
    settings: TestSettings,
    watched: Watched,
    recordings: Sequence[NDArray[np.float64]],
    rate: float,
    *,
    settle: int | None,
    max_hold: int,
    plausible: NDArray[np.float64],
    start: str,
) -> ResidualTest:
    """Return the test fitted to fault-free recordings, each of shape (1, time, channels), in plant units."""
    generator, known = watched.generator, settings.known(watched)
    _check_recordings(recordings, len(generator.plant.inputs))
    if known is not None and known.is_bound:  # bounds want a longer wait, and hold from rest
        settle = settling_samples(generator, known) if settle is None else settle
        start = "rest"
    blank = specification(
        generator,
        blank_test(generator),
        NoIsolation(),
        settle=settle,
        max_hold=max_hold,
        plausible=plausible,
        start=start,
    )
    run = _run(blank, watched, recordings, settling_reason(generator, blank.settle))
    try:
        test = settings.fitted(watched, run, rate)
    except DataError as error:
        if 2 * blank.settle * len(recordings) < len(run.usable):
            raise
        raise DataError(f"{error}; {settling_reason(generator, blank.settle)}") from error
    if len(recordings) == 1:
        return test
    basis = f"{test.basis}; {len(recordings)} recordings, each from its own start"
    return replace(test, basis=basis)  # pyright: ignore[reportArgumentType]


def _check_recordings(recordings: Sequence[NDArray[np.float64]], n_inputs: int) -> None:
    for number, data in enumerate(recordings, 1):
        which = f"recording {number} of {len(recordings)}" if len(recordings) > 1 else "this recording"
        if len(data) != 1:
            raise DataError(f"{which} has the shape (plants, time, channels): fit takes (time, channels), or several")
        outputs = data[0, :, n_inputs:]
        if len(outputs) > 1 and not np.nanmax(np.ptp(np.where(np.isfinite(outputs), outputs, 0.0), axis=0)) > 0:
            raise DataError(f"no output ever changes in {which}: it cannot show what is normal")


def _run(
    blank: Specification, watched: Watched, recordings: Sequence[NDArray[np.float64]], reason: str
) -> FaultFreeRun:
    """Run over each recording from a start of its own."""
    runs = [run_block(blank, initial_state(blank, 1), data)[1] for data in recordings]
    if len(recordings) > 1:
        for number, (one, data) in enumerate(zip(runs, recordings, strict=True), 1):
            if not one.usable.any():
                raise DataError(
                    f"recording {number} of {len(recordings)} has no usable sample: {data.shape[1]} samples, {reason}; "
                    "leave it out"
                )
    deviations = np.concatenate([plausible_values(blank, data)[0][0] for data in recordings])
    return FaultFreeRun(
        np.concatenate([one.residuals[0] for one in runs]),
        np.concatenate([one.usable[0] for one in runs]),
        tuple(int(k) for k in np.cumsum([data.shape[1] for data in recordings[:-1]])),
        signal_levels(watched.generator, deviations),
    )
