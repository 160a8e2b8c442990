"""Constants of a running monitor: of its filter, test and isolation, from a design and settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.isolation import Isolation, IsolationSettings, NoIsolation
from residua.decide.kinds import ISOLATIONS
from residua.decide.member_bounds import MemberBounds
from residua.decide.multiscale_ewma import MultiscaleEWMA
from residua.decide.norm_threshold import NormTest
from residua.decide.peak_threshold import PeakThreshold
from residua.decide.test import ResidualTest, TestSettings, Watched
from residua.design import ResidualGenerator
from residua.design.banks.bank import maps_of
from residua.design.core.decoupling import Approximate, Decoupled, Promise, reached
from residua.design.core.evidence import of_sampling
from residua.design.core.generator import BoundedDesign, CertifiedDesign, DesignWithTest, make_generator
from residua.errors import ModelError, SettingError
from residua.linear import StateSpace
from residua.linear.systems.state_space import stack_systems
from residua.monitor.inputs import settling_samples
from residua.monitor.partial_update import PartialUpdate, partial_update
from residua.monitor.start_estimate import StartFit, start_fit
from residua.plant.channels import ROLES
from residua.visible import echo


@dataclass(frozen=True, eq=False)
class Specification:
    """Constant parameters of a running monitor.

    Attributes
    ----------
    A, B, C, D : ndarray
        Of the sampled generator, driven by ``[u, y]`` as deviations.
    start : ndarray, shape (states, channels)
        Maps a sample to the filter state that it would settle to.
    offset : ndarray, shape (channels,)
        Operating point.
    test : ResidualTest
        Test that turns the residual into a statistic and an alarm.
    isolation : Isolation
        Isolation that names the fault.
    settle : int
        Samples after a start, or after a held value, in which nothing is decided.
    max_hold : int
        Longest gap over which missing values are held; after a longer one the filter restarts.
    plausible : ndarray, shape (channels, 2)
        Smallest and largest deviation of each channel from its operating point that is taken for a value; any other is
        missing.
    first : StartFit or None
        Estimator of a start from the first residuals; ``None`` if a start is from rest.
    partial : PartialUpdate or None
        Data of a Kalman filter for missing outputs; ``None`` for any other generator.
    """

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]
    start: NDArray[np.float64]
    offset: NDArray[np.float64]
    test: ResidualTest
    isolation: Isolation
    settle: int
    max_hold: int
    plausible: NDArray[np.float64]
    first: StartFit | None
    partial: PartialUpdate | None

    @property
    def held(self) -> int:
        """Number of channels whose missing values are held: a Kalman filter leaves missing outputs out instead."""
        return self.B.shape[1] if self.partial is None else self.partial.B.shape[1]

    @property
    def members(self) -> tuple[str, ...]:
        """Names of the parts with their own alarm: members of a bank, or groups of residuals."""
        return self.test.part_names


@dataclass(frozen=True, eq=False)
class FilterState:
    """State of the filter of a running monitor; every array has one row per plant.

    Counters of 32 bits stop at :data:`residua.decide.persistence.LAST_COUNT`. Those of :data:`SELDOM` are zero as a
    rule, and take no memory for plants all of which have zeros.

    Attributes
    ----------
    x : ndarray, shape (plants, states)
        Filter state, in its own units: 8 bytes for each.
    held : ndarray, shape (plants, channels)
        Last value of each channel as a deviation, in plant units: 8 bytes for each. Of a Kalman filter that goes on
        without missing outputs, those of the inputs alone.
    gap : ndarray of int32
        Incomplete samples in a row, or of such a Kalman filter those without any output that it can use.
    running : ndarray of bool
        Whether the filter has been started.
    age : ndarray of int32
        Samples since its start or the last held value.
    resets, broken : ndarray of int
        Restarts after long gaps, and of a filter whose state overflowed.
    starting : ndarray of bool
        Whether the start is still to be estimated.
    start_sums : ndarray, shape (plants, states)
        Sums of residuals for the estimate of the start; zero if none is to be estimated.
    moved : ndarray
        How far an estimate of the start moved a residual, in units of the threshold, at most; zero where it is less
        than :data:`residua.monitor.start_estimate.MOVED_FROM`.
    apart : ndarray of bool
        Whether a Kalman filter is off its stationary one, since outputs were missing.
    spread : ndarray, shape (plants, states, states)
        Its covariance then, zero for the stationary one.
    bent : ndarray, shape (plants, ages + 1, faults, states)
        How far its errors by faults are off.
    """

    x: NDArray[np.float64]
    held: NDArray[np.float64]
    gap: NDArray[np.int32]
    running: NDArray[np.bool_]
    age: NDArray[np.int32]
    resets: NDArray[np.int64]
    broken: NDArray[np.int64]
    starting: NDArray[np.bool_]
    start_sums: NDArray[np.float64]
    moved: NDArray[np.float64]
    apart: NDArray[np.bool_]
    spread: NDArray[np.float64]
    bent: NDArray[np.float64]


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


_ALIKE = ("inputs", "outputs", "faults", "disturbances", "dt")
_EQUAL = ("A", "E", "C", *(matrix + role for role in ROLES.values() for matrix in "BD"))


def with_estimator(bank: ResidualGenerator, estimator: ResidualGenerator) -> ResidualGenerator:
    """Return a bank with the estimates of a fault estimator as further outputs, not tested by any member.

    Parameters
    ----------
    bank, estimator : ResidualGenerator
        Both for the same plant: ``codes`` of the one, ``estimated`` of the other.

    Raises
    ------
    ModelError
        If the first is not a bank, the second not an estimator, or their plants differ.
    """
    if bank.codes is None:
        raise ModelError("an estimator runs beside a bank, whose members are tested one by one; this is not a bank")
    if not estimator.estimated:
        raise ModelError("estimator= must be a fault estimator: this generator estimates no fault")
    one, other = bank.plant, estimator.plant
    differ = [name for name in _ALIKE if getattr(one, name) != getattr(other, name)]
    differ += [name for name in _EQUAL if not np.array_equal(getattr(one, name), getattr(other, name))]
    if differ:
        raise ModelError(
            f"bank and estimator are for different plants ({', '.join(differ)}): design both for bank.plant"
        )
    system = stack_systems([bank.system, estimator.system])
    names = [*bank.residuals, *estimator.residuals]
    promise, cost = _promise(bank, estimator, system)
    return make_generator(
        system.replaced(outputs=names),
        one,
        f"{bank.method}, with {estimator.method}",
        bank.evidence.extended(decoupling=cost, notes=(f"beside it, tested by no member: {estimator.method}",)),
        decouples=promise,
        **maps_of([bank, estimator], names),
        members=bank.members,
        codes=bank.codes,
        estimated=("",) * bank.n_residuals + estimator.estimated,
    )


def _promise(
    bank: ResidualGenerator, estimator: ResidualGenerator, system: StateSpace
) -> tuple[Promise, dict[str, float]]:
    """Return the common promise of both, and the cost of sampling, which bounds the promise of sampled designs."""
    if bank.state_map is not None and estimator.state_map is not None:
        return Decoupled(disturbances="disturbance" in bank.evidence.decoupling), {}
    cost = of_sampling(reached(system, bank.plant, None))
    return Approximate(next(iter(cost), "")), cost
