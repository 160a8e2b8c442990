"""Specification of a monitor from a design and settings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.isolation import IsolationSettings, NoIsolation
from residua.decide.kinds import ISOLATIONS
from residua.decide.member_bounds import MemberBounds
from residua.decide.multiscale_ewma import MultiscaleEWMA
from residua.decide.norm_threshold import NormTest
from residua.decide.peak_threshold import PeakThreshold
from residua.decide.test import ResidualTest, TestSettings, Watched
from residua.design import ResidualGenerator
from residua.design.core.generator import BoundedDesign, CertifiedDesign, DesignWithTest
from residua.errors import ModelError, SettingError
from residua.monitor.inputs import settling_samples
from residua.monitor.partial_update import partial_update
from residua.monitor.specification import Specification
from residua.monitor.starting import start_fit
from residua.visible import echo

#: Numbers that the windows of a monitor may keep for each plant; more is a mistake in the window.
_MOST_NUMBERS = 10**7
#: Message for an invalid ``isolate``.
_KINDS = (
    "isolate must be 'auto', Directional(...), Structured(...), Matched(...), Likelihood(...), one of your own, or None"
)


def chosen_isolation(isolate: Any, generator: ResidualGenerator, design: Any = None) -> IsolationSettings:
    """Return the settings of the isolation; ``"auto"``: of the kind for which the design is made."""
    if isinstance(isolate, str) and isolate == "auto":
        offers = (kind.for_design(design, generator) for kind in reversed(ISOLATIONS.values()))
        isolate = next(offer for offer in offers if offer is not None)
    if isolate is None:
        return NoIsolation()
    if not isinstance(isolate, IsolationSettings):
        raise SettingError(f"{_KINDS}, got {echo(isolate)}")
    isolate.check(generator)
    return isolate


def chosen_test(
    test: Any, design: Any, generator: ResidualGenerator, isolate: IsolationSettings
) -> tuple[TestSettings, dict[str, float]]:
    """Return the settings of the test, and the thresholds certified by the design; empty if none are used.

    Without settings: :class:`PeakThreshold` for a design with certified thresholds, the test that a design is made for
    where it brings one, else :class:`MultiscaleEWMA`.
    """
    if test is not None and not isinstance(test, TestSettings):
        raise SettingError(
            f"test must be NormThreshold(...), PeakThreshold(...), or TestSettings of your own, got {echo(test)}"
        )
    certified: dict[str, float] = {}
    if test is None or test.takes_certified:
        certified = brought_thresholds(design, generator)
    if test is None:
        test = PeakThreshold() if certified else brought_test(design, isolate)
    isolate.test_of(test).check(Watched(generator, isolate.parts(generator), certified))
    return test, certified if test.uses_certified else {}


def brought_test(design: Any, isolate: IsolationSettings) -> TestSettings:
    """Return the settings of the test of a design or of its isolation; else a bank of means.

    The test of matched filters is one of likelihoods.
    """
    test = design.test if isinstance(design, DesignWithTest) else isolate.own_test(design) or MultiscaleEWMA()
    if not isinstance(test, TestSettings):
        raise ModelError(f"the test of this design must be TestSettings, got {echo(test)}")
    return test


def brought_thresholds(design: Any, generator: ResidualGenerator) -> dict[str, float]:
    """Return the certified thresholds of a design for the members of its generator; empty without.

    Raises
    ------
    ModelError
        If they are not one positive finite number for each member.
    """
    thresholds = design.thresholds if isinstance(design, CertifiedDesign) else None
    if not isinstance(thresholds, Mapping) or not thresholds:
        return {}
    try:
        settings = PeakThreshold(thresholds)
        settings.for_members([member.name for member in generator.members])
    except SettingError as error:
        raise ModelError(f"the certified thresholds of this design do not fit its members: {error}") from error
    assert isinstance(settings.thresholds, dict)
    return {name: float(value) for name, value in settings.thresholds.items()}


def brought_bounds(design: Any, generator: ResidualGenerator) -> dict[str, MemberBounds]:
    """Return the certified bounds of a design for the members of its generator; empty without."""
    if not isinstance(design, BoundedDesign):
        return {}
    bounds_of = design.member_bounds
    if set(bounds_of) != {member.name for member in generator.members}:
        return {}
    return {name: MemberBounds(*bounds) for name, bounds in bounds_of.items()}


def check_windows(settings: TestSettings, isolate: IsolationSettings, watched: Watched) -> None:
    """Raise if sums are over more samples than fit into memory."""
    for asked in (settings.kept(watched), isolate.kept(watched.generator)):
        if asked is None:
            continue
        subject, window, each = asked
        if window * each > _MOST_NUMBERS:
            raise SettingError(
                f"{subject} keeps {window * each:,} numbers for each plant, the most is {_MOST_NUMBERS:,}: "
                f"a window of {max(1, _MOST_NUMBERS // each):,} samples at most, or sample more slowly"
            )


def blank_test(generator: ResidualGenerator) -> NormTest:
    """Return a test that never raises an alarm, to see the residuals before there is a threshold."""
    n = generator.n_residuals
    return NormTest(np.zeros(n), np.eye(n), np.inf, 1, 1, 1, "")


def specification(
    generator: ResidualGenerator,
    test: ResidualTest,
    isolate: IsolationSettings,
    *,
    settle: int | None,
    max_hold: int,
    plausible: NDArray[np.float64],
    start: str,
) -> Specification:
    """Return the specification; ``plausible`` are the limits of every channel, as deviations."""
    system, point = generator.system, generator.plant.operating_point
    settled = settling_samples(generator, test) if settle is None else int(settle)
    return Specification(
        system.A,
        system.B,
        system.C,
        system.D,
        np.asarray(np.linalg.solve(np.eye(system.n_states) - system.A, system.B), dtype=float),
        np.array([*point.inputs, *point.outputs]),
        test,
        isolate.isolation(generator, test),
        settled,
        max_hold,
        plausible,
        start_fit(generator, test, settled) if start == "estimated" and not test.is_bound else None,
        partial_update(generator, test),
    )
