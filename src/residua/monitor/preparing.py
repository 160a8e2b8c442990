"""What a monitor runs, made from a generator and settings: tests, signatures, codes, the specification."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.directional import Directional, direction_test
from residua.decide.matched import Matched, MatchedTest, matched_test
from residua.decide.matched_level import matched_test_from_model
from residua.decide.member_thresholds import BankTest, bank_test_from_model
from residua.decide.norm_threshold import NormTest, NormThreshold, norm_test_from_model
from residua.decide.peak_tests import is_bound
from residua.decide.peak_threshold import PeakThreshold
from residua.decide.residual_groups import GroupTest, group_test_from_model, rows_of_groups
from residua.decide.structured import CodeTest, Structured, code_test
from residua.design import ResidualGenerator
from residua.design.banks.matched_filters import MatchedFilters, step_responses
from residua.errors import ModelError, SettingError
from residua.monitor.inputs import settling_samples
from residua.monitor.partial_update import partial_update
from residua.monitor.peak_preparing import Threshold, first_peak_test, member_names, member_rows
from residua.monitor.running import Specification
from residua.monitor.starting import start_fit

#: How faults are named: by direction, by code, by matched responses, or not at all.
Isolation = Directional | Structured | Matched | None

#: What is asked for where ``isolate`` is none of these.
_KINDS = "isolate must be 'auto', Directional(...), Structured(...), Matched(...) or None"

#: Numbers that the windows of a monitor may keep for each plant; more is a mistake in the window.
_MOST_NUMBERS = 10**7
#: Largest correlation between samples, relative, with which residuals still count as white.
_WHITE = 1e-6


def as_generator(design: Any) -> ResidualGenerator:
    """Return the generator that was handed over, or the ``generator`` of a bank or an estimator.

    Other objects that could give one, such as observers, are refused: which of their residuals is meant is the
    caller's to say.
    """
    if isinstance(design, ResidualGenerator):
        return design
    inner = getattr(design, "generator", None)
    if isinstance(inner, ResidualGenerator) and not isinstance(design, type):
        return inner
    raise ModelError(
        f"a monitor runs a residual generator, got {type(design).__name__}"
        + ("; use its residual_generator()" if hasattr(design, "residual_generator") else "")
    )


def chosen_isolation(isolate: Any, generator: ResidualGenerator, design: Any = None) -> Isolation:
    """Return how faults are named.

    ``"auto"`` is by code where the generator has codes, by matched responses for matched filters, else by direction.
    """
    if isinstance(isolate, str):
        if isolate != "auto":
            raise SettingError(f"{_KINDS}, got {isolate!r}")
        if isinstance(design, MatchedFilters):
            isolate = Matched(design.window, design.steady, design.alike)
        else:
            isolate = Directional() if generator.codes is None else Structured()
    if isolate is not None and not isinstance(isolate, (Directional, Structured, Matched)):
        raise SettingError(f"{_KINDS}, got {isolate!r}")
    if isinstance(isolate, Matched):
        _check_white(generator)
    if isinstance(isolate, Structured):
        if generator.codes is None:
            raise SettingError(
                "Structured reads the code of a bank, and this generator has none: use a bank, or Directional()"
            )
        if generator.codes.shape != (len(generator.members), len(generator.faults)):
            raise ModelError(f"codes {generator.codes.shape} must have a row per member and a column per fault")
    return isolate


def check_windows(settings: Threshold, isolate: Isolation, generator: ResidualGenerator) -> None:
    """Raise where sums over so many samples are asked for that no machine could hold them."""
    k, faults = generator.n_residuals, len(generator.faults)
    asked = []
    if isinstance(settings, NormThreshold):
        columns = sum(map(len, member_rows(generator))) if isinstance(isolate, Structured) else k
        asked.append((f"NormThreshold(window={settings.window})", settings.window, columns))
    if isinstance(isolate, Directional):
        asked.append((f"Directional(window={isolate.window})", isolate.window, k))
    elif isinstance(isolate, Structured):
        asked.append((f"Structured(window={isolate.window})", isolate.window, len(generator.members)))
    elif isinstance(isolate, Matched):
        each = k + 2 + (0 if isolate.steady else faults * (k + 2))
        asked.append((f"Matched(window={isolate.window})", isolate.window + 1, each))
    for told, window, each in asked:
        if window * each > _MOST_NUMBERS:
            raise SettingError(
                f"{told} keeps {window * each:,} numbers for each plant, the most is {_MOST_NUMBERS:,}: "
                f"a window of {max(1, _MOST_NUMBERS // each):,} samples at most, or sample more slowly"
            )


def _check_white(generator: ResidualGenerator) -> None:
    """Raise unless the residuals are innovations: white, so that products with responses can simply be added."""
    advice = "design with matched_filters(plant), or kalman_filter(plant), on the sampled plant, plant.discretize(dt)"
    if not generator.faults:
        raise SettingError("Matched looks for the responses to faults, and this plant has none")
    covariance = generator.covariance
    if covariance is None:
        raise SettingError(f"Matched needs white residuals of known covariance, and this generator has none: {advice}")
    spread = np.sqrt(np.diag(covariance))
    for window in (2, 10):
        sums = generator.covariance_of_sums(window)
        assert sums is not None  # as for one sample
        off = np.abs(sums - covariance) / np.outer(spread, spread)
        if not off.max(initial=0.0) <= _WHITE:
            raise SettingError(
                f"Matched needs white residuals, and those of this generator ({generator.method}) correlate over time "
                f"({off.max():.2g}): {advice}"
            )


def responses_of(generator: ResidualGenerator, isolate: Matched, whitening: NDArray[np.float64]) -> MatchedTest:
    """Return the test of residuals that a whitening matrix goes with."""
    responses, settled = step_responses(generator, isolate.window)
    return matched_test(isolate, generator.faults, responses, settled, whitening)


def first_test(
    settings: Threshold, certified: Mapping[str, float], isolate: Isolation, generator: ResidualGenerator
) -> NormTest | BankTest | None:
    """Return the test that needs no data, or ``None`` when data are needed."""
    if isinstance(settings, PeakThreshold):
        return first_peak_test(settings, certified, generator, by_code=isinstance(isolate, Structured))
    covariance = generator.covariance_of_sums(settings.window)
    if isinstance(isolate, Structured):
        return bank_test_from_model(settings, covariance, member_rows(generator), generator.n_residuals)
    if isinstance(isolate, Matched):
        return matched_test_from_model(
            settings, covariance, generator.n_residuals, lambda w: responses_of(generator, isolate, w)
        )
    if settings.groups is not None:
        groups = rows_of_groups(settings.groups, generator.residuals)
        return group_test_from_model(settings, covariance, groups, generator.n_residuals)
    return norm_test_from_model(settings, covariance, generator.n_residuals)


def settled_codes(generator: ResidualGenerator) -> NDArray[np.bool_]:
    """Return which members a constant fault still fires once the residual has settled: (members, faults).

    A member may see a fault only while it changes; then fewer members fire in the end than the code promises.
    """
    assert generator.codes is not None
    steady = np.array([generator.steady_directions[name] for name in generator.faults])
    steady = steady.reshape(len(generator.faults), generator.n_residuals).T
    seen = [(steady[list(rows)] != 0).any(axis=0) for rows in member_rows(generator)]
    return np.array(seen, dtype=bool).reshape(generator.codes.shape) & generator.codes


def codes_of(generator: ResidualGenerator, isolate: Structured) -> CodeTest:
    """Return the codes that a bank is read by: those of its faults, and those of constant faults where they differ."""
    assert generator.codes is not None
    return code_test(
        isolate, generator.codes, generator.faults, member_names(generator), settled=settled_codes(generator)
    )


def blank_test(generator: ResidualGenerator) -> NormTest:
    """Return a test that never raises an alarm: to see the residuals before there is a threshold."""
    n = generator.n_residuals
    return NormTest(np.zeros(n), np.eye(n), np.inf, 1, 1, 1, "")


def specification(
    generator: ResidualGenerator,
    test: NormTest | BankTest,
    isolate: Isolation,
    *,
    settle: int | None,
    max_hold: int,
    plausible: NDArray[np.float64],
    start: str,
) -> Specification:
    """Return what runs; ``plausible`` are the limits of every channel, as deviations."""
    system, point = generator.system, generator.plant.operating_point
    direction = codes = matched = None
    if isinstance(isolate, Structured) and generator.codes is not None:
        codes = codes_of(generator, isolate)
    elif isinstance(isolate, Matched):
        matched = responses_of(generator, isolate, test.whitening)
    elif isinstance(isolate, Directional):
        whitening = test.whole if isinstance(test, GroupTest) else test.whitening
        direction = direction_test(
            isolate, generator.subspaces, generator.steady_directions, whitening, generator.residual_rank
        )
    settled = settling_samples(generator, test) if settle is None else int(settle)
    return Specification(
        system.A,
        system.B,
        system.C,
        system.D,
        np.asarray(np.linalg.solve(np.eye(system.n_states) - system.A, system.B), dtype=float),
        np.array([*point.inputs, *point.outputs]),
        test,
        direction,
        codes,
        matched,
        settled,
        max_hold,
        plausible,
        start_fit(generator, test, settled) if start == "estimated" and not is_bound(test) else None,
        partial_update(generator, matched, test.whitening),
    )
