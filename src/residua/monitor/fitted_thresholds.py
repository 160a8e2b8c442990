"""Thresholds fitted to fault-free recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import check_samples, is_number
from residua.decide.explanation import Whitening, colour_of
from residua.decide.fault_free import FaultFree, shrunk
from residua.decide.held_out import LEAST, alarms_held_out, held_out_rows
from residua.decide.isolation import NoIsolation
from residua.decide.stationarity import changes, transient_samples
from residua.decide.test import FaultFreeRun, ResidualTest, TestSettings, Watched
from residua.design import ResidualGenerator
from residua.errors import DataError, SettingError
from residua.monitor.fit_check import Explained, FitCheck, visible_sizes
from residua.monitor.fused import run_block
from residua.monitor.inputs import settling_reason, settling_samples, signal_levels
from residua.monitor.outcome import compared_outputs
from residua.monitor.running import initial_state, plausible_values
from residua.monitor.specification import Specification, blank_test, specification
from residua.recording.levels import level_and_spread, units_at_point, units_between
from residua.visible import echo
from residua.words import counted, listing

#: Largest part that may be held out.
MOST_HELD_OUT = 0.5
#: Residuals this many times as large as the noise of the plant makes them are not explained by its size.
_FAR_LARGER = 10.0


def fitted_test(
    settings: TestSettings,
    watched: Watched,
    recordings: Sequence[NDArray[np.float64]],
    rate: float | None,
    *,
    settle: int | None,
    max_hold: int,
    plausible: NDArray[np.float64],
    start: str,
    held_out: float,
    transient: int | str,
) -> tuple[ResidualTest, FitCheck, NDArray[np.float64]]:
    """Return the test fitted to fault-free recordings of shape (1, time, channels), in plant units, and its check.

    And the covariance of the fault-free residuals.

    The last part of every recording, ``held_out`` of its usable samples, is left to the check. Without a rate the fit
    aims at that of the settings, or by the rows that it uses.
    """
    generator, known = watched.generator, settings.known(watched)
    if known is not None and known.is_bound:  # bounds want a longer wait, and hold from rest
        settle = settling_samples(generator, known) if settle is None else settle
        start = "rest"
    blank, run = fault_free_run(
        generator, recordings, settle=settle, max_hold=max_hold, plausible=plausible, start=start
    )
    try:
        if known is not None and known.is_bound:  # data change no threshold
            asked = settings.asked(watched) if rate is None else rate
            bounds = _with_basis(settings.fitted(watched, run, asked), len(recordings), "")
            check = replace(FitCheck(None), **_levels(blank, generator, recordings, run))
            return bounds, check, fault_free_covariance(run)
        run, left_out = _without_transients(run, transient, generator.residuals)
        kept = settings.kept(watched)
        window = 1 if kept is None else kept[1]
        rows = held_out_rows(run, held_out, window)
        test, check = _fitted(settings, watched, run, rows, rate)
    except DataError as error:
        if 2 * blank.settle * len(recordings) < len(run.usable):
            raise
        raise DataError(f"{error}; {settling_reason(generator, blank.settle)}") from error
    check = replace(check, changes=changes(run, generator.residuals), left_out=left_out, recordings=len(recordings),
                    colour=_colour(test, run), visible=visible_sizes(generator, test, run),
                    explained=_explained(generator, run, rows),
                    **_levels(blank, generator, recordings, run))  # fmt: skip
    test = _with_basis(test, len(recordings), f"; {_checked(check, held_out, int(run.usable.sum()))}")
    return test, check, fault_free_covariance(run)


def _explained(
    generator: ResidualGenerator, run: FaultFreeRun, held: NDArray[np.bool_] | None
) -> tuple[Explained, ...]:
    """Return the explained share of the outputs of a filter, on the held-out rows if there are any."""
    rows = run.usable if held is None else run.usable & held
    m, plant = len(generator.plant.inputs), generator.plant
    if run.signals is None or np.count_nonzero(rows) < LEAST:
        return ()
    rows = rows & np.isfinite(run.signals).all(axis=1)
    out = []
    for i, j in compared_outputs(generator):
        whole, left = run.signals[rows, m + j].var(), run.residuals[rows, i].var()
        if whole > 0:
            out.append(Explained(plant.outputs[j], float(1 - left / whole)))
    return tuple(out)


def _colour(test: ResidualTest, run: FaultFreeRun) -> tuple[float, ...]:
    """Return the variances of sums of the white residuals, over samples known in a row."""
    whitening = Whitening.of(test)
    if whitening is None:
        return ()
    white, known = whitening.of_residuals(run.residuals, run.usable)
    changes_at = np.flatnonzero(np.diff(known.astype(np.int8)) != 0) + 1
    bounds = sorted({0, *changes_at.tolist(), *run.seams, len(known)})
    return colour_of(white, [slice(*part) for part in pairwise(bounds) if known[part[0]]])


def fault_free_run(
    generator: ResidualGenerator,
    recordings: Sequence[NDArray[np.float64]],
    *,
    settle: int | None,
    max_hold: int,
    plausible: NDArray[np.float64],
    start: str,
) -> tuple[Specification, FaultFreeRun]:
    """Return a specification without a test, and its residuals on fault-free recordings, each from its own start."""
    _check_recordings(recordings, len(generator.plant.inputs))
    blank = specification(
        generator,
        blank_test(generator),
        NoIsolation(),
        settle=settle,
        max_hold=max_hold,
        plausible=plausible,
        start=start,
    )
    return blank, _run(blank, generator, recordings, settling_reason(generator, blank.settle))


def fault_free_covariance(run: FaultFreeRun) -> NDArray[np.float64]:
    """Return the covariance of fault-free residuals, as far as their number allows."""
    data = FaultFree(run.residuals, run.usable, 1, run.seams)
    rows = data.deviations[run.usable]
    return shrunk(rows.T @ rows / max(1, len(rows) - 1), len(rows) / data.worth[0])[0]


def _fitted(
    settings: TestSettings, watched: Watched, run: FaultFreeRun, held: NDArray[np.bool_] | None, rate: float | None
) -> tuple[ResidualTest, FitCheck]:
    """Return the fitted test, and its check on held-out data; none is held out if too little would remain."""
    used = run if held is None else replace(run, usable=run.usable & ~held)
    rows = int(used.usable.sum())
    aimed = settings.asked(watched, rows) if rate is None else rate
    try:
        test = settings.fitted(watched, used, aimed)
    except DataError:
        if held is None:
            raise
        return _fitted(settings, watched, run, None, rate)
    out = None if held is None else alarms_held_out(test, run, held, aimed)
    return test, FitCheck(out, rows=rows, aimed=aimed, promised=test.promised)


def _checked(check: FitCheck, share: float, samples: int) -> str:
    """Describe the data of the check of a fit."""
    if check.held_out is not None:
        out = str(check.held_out)
    else:
        out = f"no samples held out, {samples} are too few" if share else "no samples held out"
    if check.left_out:
        out += f"; the first {check.left_out} left out as a transient"
    return out


def check_held_out(held_out: Any, transient: Any) -> None:
    """Raise unless the held-out part and the start that is left out are valid."""
    if not (is_number(held_out) and 0 <= held_out <= MOST_HELD_OUT):
        raise SettingError(f"held_out must be a part from 0 to {MOST_HELD_OUT:g}, got {echo(held_out)}")
    if transient != "auto":
        check_samples(transient, "transient", least=0)


def _with_basis(test: ResidualTest, recordings: int, more: str) -> ResidualTest:
    several = f"; {recordings} recordings, each from its own start" if recordings > 1 else ""
    return replace(test, basis=f"{test.basis}{more}{several}")  # pyright: ignore[reportArgumentType]


def _without_transients(run: FaultFreeRun, transient: int | str, residuals: Sequence[str]) -> tuple[FaultFreeRun, int]:
    """Return a run without the beginnings of its recordings, and the number of samples removed."""
    if transient == 0:
        return run, 0
    usable, found = run.usable.copy(), changes(run, residuals) if transient == "auto" else ()
    for number, start in enumerate((0, *run.seams), 1):
        samples = transient_samples(found, number) if transient == "auto" else int(transient)
        usable[start : start + samples] = False
    return replace(run, usable=usable), int(run.usable.sum() - usable.sum())


def _levels(
    blank: Specification, generator: ResidualGenerator, recordings: Sequence[NDArray[np.float64]], run: FaultFreeRun
) -> dict[str, Any]:
    """Return mean and spread of each channel, as fields of a check, and contradictions with the plant."""
    plant = generator.plant
    channels = (*plant.inputs, *plant.outputs)
    values = [plausible_values(blank, data)[0][0] + blank.offset for data in recordings]
    each = [level_and_spread(one) for one in values]
    mean, spread = level_and_spread(np.concatenate(values))
    sources = [f"recording {number}" for number in range(1, len(values) + 1)]
    units = units_between(channels, sources, *(np.array(part) for part in zip(*each, strict=True)))
    units += units_at_point(channels, mean, spread, blank.offset)
    known = np.isfinite(mean) & np.isfinite(spread)
    doubts = (*_standing_still(plant.outputs, spread[len(plant.inputs) :]), *_far_larger(generator, run))
    mean, spread = np.where(known, mean, 0.0), np.where(known, spread, 0.0)
    return {"mean": tuple(mean.tolist()), "spread": tuple(spread.tolist()), "units": tuple(units), "doubts": doubts}


def _standing_still(outputs: Sequence[str], spread: NDArray[np.float64]) -> list[str]:
    """Return the outputs that never move where others do."""
    still = [repr(name) for name, one in zip(outputs, spread.tolist(), strict=True) if one == 0]
    if not still or not np.nanmax(spread, initial=0.0) > 0:
        return []
    return [
        f"{listing(still)} never {'moves' if len(still) == 1 else 'move'} in these recordings, as of a dead sensor or "
        "a column without data: what is normal of it they do not show"
    ]


def _far_larger(generator: ResidualGenerator, run: FaultFreeRun) -> list[str]:
    """Return the residuals that are far larger than the noise in the plant's model makes them."""
    covariance = generator.covariance_of_sums(1)
    if covariance is None or not run.usable.any():
        return []
    expected = np.sqrt(np.diag(covariance))
    expected, rows = np.where(expected > 0, expected, np.inf), run.residuals[run.usable]
    found = []
    for ratio, said, causes in (
        (rows.std(axis=0) / expected, "moves {} times as much as the noise of the plant explains", _MOVES),
        (
            np.abs(rows.mean(axis=0)) / expected,
            "lies {} standard deviations of the plant's noise off zero",
            _OFF,
        ),
    ):
        far = np.flatnonzero(ratio > _FAR_LARGER)
        if far.size:
            worst = int(far[ratio[far].argmax()])
            more = f", and {counted(len(far) - 1, 'other')} more than {_FAR_LARGER:g} times" if len(far) > 1 else ""
            told = said.format(f"{ratio[worst]:.2g}")
            found.append(f"the residual {generator.residuals[worst]!r} {told}{more}: {causes}")
    return found


#: Causes of residuals far larger than the noise of the plant, and consequences.
_MOVES = (
    "check for swapped columns, other units, a dead sensor, or a wrong model. A threshold that "
    "covers this hides faults; residual_report shows more"
)
_OFF = "check for swapped columns or another operating point. The fit treats this as normal"


def _check_recordings(recordings: Sequence[NDArray[np.float64]], n_inputs: int) -> None:
    for number, data in enumerate(recordings, 1):
        which = f"recording {number} of {len(recordings)}" if len(recordings) > 1 else "this recording"
        if len(data) != 1:
            raise DataError(f"{which} has the shape (plants, time, channels): fit takes (time, channels), or several")
        outputs = data[0, :, n_inputs:]
        if len(outputs) and not np.isfinite(outputs).any():
            raise DataError(f"no output has a value in {which}: it shows no normal operation")
        if len(outputs) > 1 and not np.nanmax(np.ptp(np.where(np.isfinite(outputs), outputs, 0.0), axis=0)) > 0:
            raise DataError(f"no output ever changes in {which}: it shows no normal operation")


def _run(
    blank: Specification, generator: ResidualGenerator, recordings: Sequence[NDArray[np.float64]], reason: str
) -> FaultFreeRun:
    """Run over each recording from its own start."""
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
        signal_levels(generator, deviations),
        deviations,
    )
