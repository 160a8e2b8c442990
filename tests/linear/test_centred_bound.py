"""Bounds around the centre of an uncertain set: against members, orders of convergence, and what is hard in numbers."""

from __future__ import annotations

import numpy as np
import pytest

from effort import cases, rounds
from residua.linear import UncertainSystem, peak_norm, robust_peak_norm
from residua.linear.norms import impulse_terms
from residua.robust.bounds import centred
from residua.robust.bounds.centred import centred_bound
from residua.robust.bounds.star import CommonEllipsoid, _least, common_ellipsoid, scaled_problem, verified_star


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
@pytest.mark.parametrize("part", rounds(4, 10))
def test_no_member_is_above(outputs, part):
    for seed in range(4 * part if outputs == 1 else part):
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


@pytest.mark.parametrize("pole", cases([0.9999, 0.9996, 0.99995], 1))
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
    assert sure.shares.sum() <= 1 + 1e-12
    assert largest(system) <= sure.bound
    smaller = CommonEllipsoid(0.8 * found.Q, found.shares, np.zeros_like(found.spare))
    assert verified_star(system, problem, smaller) is None
    # with room to be added it is repaired
    with_room = CommonEllipsoid(0.9999999 * found.Q, found.shares, found.spare)
    repaired = verified_star(system, problem, with_room)
    assert repaired is not None
    assert largest(system) <= repaired.bound
    assert np.linalg.eigvalsh(repaired.Q)[0] > 0


def test_what_is_no_ellipsoid_is_not_believed():
    # of an unstable direction with a negative extent the inequality holds as well
    system = UncertainSystem(
        np.diag([0.5, 2.0]), np.zeros((2, 1)), [[1.0], [0.0]], np.zeros((1, 2)), [[1, 1]], low=[0], high=[0], dt=1
    )
    for Q in (np.diag([10.0, -1.0]), np.diag([10.0, 1.0])):
        assert _least(Q, [np.diag([0.5, 2.0])], system.Bw, np.array([0.8, 0.2])) < 0


@pytest.mark.parametrize(("parameters", "outputs"), [(12, 1), (6, 2)])
def test_parameters_whose_corners_are_not_visited(parameters, outputs):
    # lags side by side, each moved by a parameter of its own: as many corners as there are count
    rng = np.random.default_rng(parameters)
    n = parameters
    Cz = np.ones((outputs, n)) + 0.1 * rng.standard_normal((outputs, n))
    system = UncertainSystem(
        0.5 * np.eye(n), np.eye(n), np.ones((n, 1)), np.eye(n), Cz, low=[-0.1] * n, high=[0.1] * n, dt=1
    )
    whole = centred_bound(system)
    assert whole is not None
    worst = peak_norm(system.member([0.1] * n), rtol=1e-3).attained
    first = peak_norm(system.member([0.0] * n)).attained * (1 + 0.1 / 0.5)  # 1/(1-a) to first order
    assert whole.linear >= first * (1 - 1e-6)
    assert worst <= whole.value <= 1.05 * worst


def test_where_the_responses_are_too_long_an_ellipsoid_serves(monkeypatch):
    system = slow(3e-5)
    before = robust_peak_norm(system)
    monkeypatch.setattr(centred, "_TERMS", 512)
    assert centred_bound(system) is None
    star = robust_peak_norm(system, method="star")
    found = robust_peak_norm(system, method="centred")
    assert (found.method, found.bound) == ("star", star.bound)
    assert "ellipsoid" in found.note
    cut = robust_peak_norm(system, method="centred", boxes=8, rtol=0.0)
    assert cut.boxes == 8
    assert before.attained <= cut.bound < found.bound


def test_no_inputs_and_no_states():
    one = {"low": [-0.1], "high": [0.1], "dt": 1}
    for method in ("centred", "star", None):
        silent = UncertainSystem([[0.5]], [[1]], np.zeros((1, 0)), [[1]], [[1]], **one)
        assert robust_peak_norm(silent, method=method).bound == 0
        static = UncertainSystem(
            np.zeros((0, 0)),
            np.zeros((0, 1)),
            np.zeros((0, 1)),
            np.zeros((1, 0)),
            np.zeros((1, 0)),
            [[1]],
            [[3]],
            **one,
        )
        assert robust_peak_norm(static, method=method).bound == pytest.approx(3)


def test_what_is_cut_off_is_in_the_bound(monkeypatch):
    monkeypatch.setattr(centred, "_TAIL", 0.1)
    monkeypatch.setattr(centred, "_LARGEST_TAIL", 0.2)
    monkeypatch.setattr(impulse_terms, "_BLOCK", 4)
    for seed in range(10):
        system = generated(seed)
        found = centred_bound(system)
        assert found is None or largest(system) <= found.value * (1 + 1e-9), seed
