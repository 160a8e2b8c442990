"""Bounds around the centre of an uncertain set: against members, orders of convergence, and what is hard in numbers."""

from __future__ import annotations

import numpy as np
import pytest

from residua.linear import UncertainSystem, peak_norm, robust_peak_norm
from residua.linear.robust_norm.centred import centred_bound
from residua.linear.robust_norm.scaled_problem import scaled_problem
from residua.linear.robust_norm.verified_star import verified_star
from residua.linear.robust_norm.weighted_star import CommonEllipsoid, common_ellipsoid


def generated(seed: int, *, outputs: int = 1, size: float = 0.3, units: float = 0.0) -> UncertainSystem:
    """Return a sparse system whose parameters move it by a part of its stability margin, in units far apart."""
    rng = np.random.default_rng([seed, 77])
    n, k, m = rng.integers(1, 6), rng.integers(1, 5), rng.integers(1, 3)
    A = rng.standard_normal((n, n)) * (rng.random((n, n)) < 0.7)
    radius = max(float(np.abs(np.linalg.eigvals(A)).max()), 1e-3)
    A *= rng.choice([0.3, 0.9, 0.97]) / max(radius, 0.1)
    margin = 1 - np.abs(np.linalg.eigvals(A)).max()
    Bp, Cq = rng.standard_normal((n, k)) * (rng.random((n, k)) < 0.5), rng.standard_normal((k, n))
    Bw, Cz = rng.standard_normal((n, m)), rng.standard_normal((outputs, n))
    Dzp, Dzw = 0.3 * rng.standard_normal((outputs, k)), 0.3 * rng.standard_normal((outputs, m))
    width = size * margin / k * rng.random(k)
    T, z = 10 ** rng.uniform(-units, units, n), 10 ** rng.uniform(-units, units)
    channels = [min(i, k // 2) for i in range(k)]
    return UncertainSystem(
        A * T[:, None] / T, Bp * T[:, None], Bw * T[:, None], Cq / T, z * Cz / T, z * Dzp, z * Dzw,
        low=-width[: channels[-1] + 1], high=width[: channels[-1] + 1] / 2, channels=channels, dt=1.0,
    )  # fmt: skip


def largest(system: UncertainSystem, seed: int = 0) -> float:
    members = [*system.vertices(), *system.sample(seed, 30)]
    return max(peak_norm(system.member(v), rtol=1e-4).attained for v in members)


@pytest.mark.parametrize("outputs", [1, 2])
def test_no_member_is_above(outputs):
    for seed in range(40 if outputs == 1 else 12):
        system = generated(seed, outputs=outputs)
        found, attained = robust_peak_norm(system), largest(system)
        assert attained <= found.bound * (1 + 1e-9), seed
        assert found.bound <= 1.011 * found.attained, seed
        whole = centred_bound(system)
        assert whole is not None
        assert attained <= whole.value * (1 + 1e-9), seed


def test_units_do_not_matter():
    for seed in range(12):
        one, other = generated(seed), generated(seed, units=6)
        scale = largest(one) / largest(other)
        found = [robust_peak_norm(s, method="centred").bound for s in (one, other)]
        assert found[1] * scale == pytest.approx(found[0], rel=1e-3), seed


def test_orders_of_the_terms():
    system = generated(3, size=0.4)
    centre, half = (system.low + system.high) / 2, (system.high - system.low) / 2
    parts = [centred_bound(system.within(centre - t * half, centre + t * half)) for t in (0.1, 0.05)]
    wide, narrow = parts
    assert wide is not None
    assert narrow is not None
    assert wide.second / narrow.second == pytest.approx(4, rel=1e-3)
    assert wide.rest / narrow.rest == pytest.approx(8, rel=0.05)
    assert narrow.linear >= peak_norm(system.member(centre)).attained


def test_a_set_that_the_gains_cannot_hold_is_cut():
    wide = generated(5, size=2.5)
    whole = centred_bound(wide)
    assert whole is not None
    assert whole.gain >= 1
    assert whole.value == np.inf
    found = robust_peak_norm(wide, method="centred", boxes=200)
    assert largest(wide) <= found.bound <= 1.011 * found.attained


def slow(width: float, pole: float = 0.9999) -> UncertainSystem:
    A = [[pole, 0.0], [0.3, 0.8]]
    return UncertainSystem(A, [[-1.0], [0.0]], [[1], [0]], [[1, 0]], [[0, 1]], low=[-width], high=[width], dt=0.01)


@pytest.mark.parametrize("pole", [0.9996, 0.9999, 0.99995])
def test_slow_poles(pole):
    system = slow(0.3 * (1 - pole), pole)
    exact = 1.5 / (0.7 * (1 - pole))  # the gain from input to output of the slowest
    for method, most in (("centred", 1.2), ("star", 1.5)):
        found = robust_peak_norm(system, method=method)
        assert exact * (1 - 1e-6) <= found.bound <= most * exact, method
    assert robust_peak_norm(system).bound <= 1.011 * exact


def test_a_centre_that_sees_nothing():
    # the output is the difference of two equal lags, of which the parameter moves one
    A, B = np.diag([0.9, 0.9]), [[1], [1]]
    system = UncertainSystem(A, [[1], [0]], B, [[1, 0]], [[1, -1]], low=[-0.01], high=[0.01], dt=1)
    found = robust_peak_norm(system)
    assert found.attained == pytest.approx(1 / 0.09 - 1 / 0.1, rel=1e-3)
    assert found.ratio <= 1.011
    assert robust_peak_norm(system, method="star").ratio < 3


def test_nothing_drives_or_nothing_is_seen():
    one = {"low": [-0.1], "high": [0.1], "dt": 1}
    still = UncertainSystem([[0.5]], [[1]], [[0]], [[1]], [[1]], Dzw=[[2.0]], **one)
    for method in ("star", "centred"):
        assert robust_peak_norm(still, method=method).bound == pytest.approx(2.0)
    blind = UncertainSystem([[0.5]], [[1]], [[1]], [[1]], [[0]], Dzw=[[2.0]], **one)
    assert robust_peak_norm(blind).bound == pytest.approx(2.0, rel=1e-6)


def test_an_ellipsoid_that_is_too_small_is_not_believed():
    system = generated(1)
    problem = scaled_problem(system)
    found = common_ellipsoid(problem)
    assert found is not None
    sure = verified_star(system, problem, found)
    assert sure is not None
    assert sure.least > 0
    assert largest(system) <= sure.bound
    smaller = CommonEllipsoid(0.9 * found.bound, 0.8 * found.Q, found.shares, np.zeros_like(found.spare))
    assert verified_star(system, problem, smaller) is None
    # with room to be added the answer is an ellipsoid that holds, or none
    with_room = CommonEllipsoid(0.9 * found.bound, 0.8 * found.Q, found.shares, found.spare)
    repaired = verified_star(system, problem, with_room)
    assert repaired is None or largest(system) <= repaired.bound
