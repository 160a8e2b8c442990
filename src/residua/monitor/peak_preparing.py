"""What a monitor with a finite-horizon test runs, made from a generator, its certified thresholds and settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.matched import Matched
from residua.decide.member_thresholds import BankTest
from residua.decide.norm_threshold import NormTest, NormThreshold
from residua.decide.peak_tests import CERTIFIED, GIVEN, checked_peak_test, fit_peak_test, peak_test
from residua.decide.peak_threshold import PeakThreshold
from residua.decide.residual_groups import rows_of_groups
from residua.decide.structured import Structured
from residua.design import ResidualGenerator
from residua.errors import ModelError, SettingError
from residua.monitor.inputs import signal_size

#: When an alarm is raised.
Threshold = NormThreshold | PeakThreshold


def chosen_threshold(
    test: Any, design: Any, generator: ResidualGenerator, isolate: object
) -> tuple[Threshold, dict[str, float]]:
    """Return the settings of the test, and the thresholds that the design has certified; empty where none are used.

    Without settings: :class:`PeakThreshold` for a design with certified thresholds, else :class:`NormThreshold`.
    """
    if test is not None and not isinstance(test, (NormThreshold, PeakThreshold)):
        raise SettingError(f"test must be NormThreshold(...) or PeakThreshold(...), got {test!r}")
    if isinstance(test, NormThreshold):
        _check_groups(test, generator, isolate)
        return test, {}
    certified = brought_thresholds(design, generator)
    if test is None and not certified:
        return NormThreshold(), {}
    if isinstance(isolate, Matched):
        raise SettingError(
            "PeakThreshold tests the residual itself, and Matched how well the responses to faults explain it: "
            "test=NormThreshold(), or isolate=Directional()"
        )
    test = PeakThreshold() if test is None else test
    tested = tested_members(generator, by_code=isinstance(isolate, Structured))
    test.for_members(tested)
    if test.thresholds is not None or not certified:
        return test, {}
    if not tested:
        raise SettingError(
            "the certified thresholds of this design are for its members one by one: isolate=Structured(), or give one "
            "for the residual as a whole, test=PeakThreshold(...), or test=NormThreshold()"
        )
    if not generator.system.is_discrete:
        raise SettingError(
            "the certified thresholds of this design are for its continuous filter, and a monitor runs a sampled one: "
            "design for the sampled plant, plant.discretize(dt), or test=NormThreshold()"
        )
    return test, certified


def _check_groups(test: NormThreshold, generator: ResidualGenerator, isolate: object) -> None:
    """Raise where groups of residuals do not go with how faults are named, or with the residuals."""
    if test.groups is None:
        return
    if isinstance(isolate, (Structured, Matched)):
        kind = (
            "by code, and its members are tested one by one already" if isinstance(isolate, Structured) else "matched"
        )
        raise SettingError(
            f"groups are for residuals that are named by direction or not at all; here faults are {kind}: leave groups "
            "out, or isolate=Directional() or None"
        )
    rows_of_groups(test.groups, generator.residuals)


def brought_thresholds(design: Any, generator: ResidualGenerator) -> dict[str, float]:
    """Return the thresholds that a design brings for the members of its generator; empty for one that brings none.

    Raises
    ------
    ModelError
        If they are not one positive finite number for each member.
    """
    found = getattr(design, "thresholds", None)
    if not isinstance(found, Mapping) or not found:
        return {}
    try:
        settings = PeakThreshold(found)
        settings.for_members(member_names(generator))
    except SettingError as error:
        raise ModelError(f"the certified thresholds of this design do not fit its members: {error}") from error
    assert isinstance(settings.thresholds, dict)
    return {name: float(value) for name, value in settings.thresholds.items()}


def first_peak_test(
    settings: PeakThreshold, certified: Mapping[str, float], generator: ResidualGenerator, *, by_code: bool
) -> NormTest | BankTest | None:
    """Return the test with the thresholds that are given or certified; ``None`` without any."""
    basis = GIVEN
    if settings.thresholds is None and certified:
        settings, basis = replace(settings, thresholds=certified), CERTIFIED
    thresholds = settings.for_members(tested_members(generator, by_code=by_code))
    if thresholds is None:
        return None
    return peak_test(settings, thresholds, basis, generator.n_residuals, member_rows(generator) if by_code else None)


def fitted_peak_test(
    settings: PeakThreshold,
    certified: Mapping[str, float],
    generator: ResidualGenerator,
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    deviations: NDArray[np.float64],
    rate: float,
    *,
    by_code: bool,
    seams: Sequence[int] = (),
) -> NormTest | BankTest:
    """Return the test fitted to fault-free residuals; thresholds that are known stay, and are held against them."""
    known = first_peak_test(settings, certified, generator, by_code=by_code)
    if known is not None:
        return checked_peak_test(known, residuals, usable, member_names(generator) if by_code else (), seams)
    rows = member_rows(generator) if by_code else None
    sizes = [signal_size(generator, deviations, part) for part in rows or [None]]
    return fit_peak_test(
        settings, residuals, usable, false_alarm_rate=rate, signal_sizes=sizes, members=rows, seams=seams
    )


def tested_members(generator: ResidualGenerator, *, by_code: bool) -> list[str]:
    """Return the members that have a threshold of their own; a generator of one member is that as a whole."""
    alone = len(generator.members) == 1 and len(generator.members[0].residuals) == generator.n_residuals
    return member_names(generator) if by_code or alone else []


def no_threshold(settings: Threshold) -> str:
    """Say where a threshold can come from."""
    start = "this monitor has no threshold: fit(u, y) it to fault-free data"
    if isinstance(settings, PeakThreshold):
        return f"{start}, or set PeakThreshold(thresholds=...)"
    return f"{start}, give the plant noise (with_noise), or set NormThreshold(threshold=...)"


def member_names(generator: ResidualGenerator) -> list[str]:
    """Return the names of the members of a bank."""
    return [member.name for member in generator.members]


def member_rows(generator: ResidualGenerator) -> list[tuple[int, ...]]:
    """Return the residual numbers of each member of a bank."""
    return [member.residuals for member in generator.members]
