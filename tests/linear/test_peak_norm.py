from __future__ import annotations

import itertools
import sys

import numpy as np
import pytest

from guards import trips
from refusals import Refused
from residua.errors import AccuracyError, MissingExtraError, ModelError, SettingError
from residua.linear import StateSpace, peak_input, peak_norm
from residua.linear.norms import impulse_terms
from residua.linear.norms.impulse_terms import StableSystem

A = [[0.5, 0.2], [-0.1, 0.7]]
KNOWN = {
    "lag": (StateSpace([[0.8]], [[1]], [[1]], dt=1), 5, 5),
    "one output": (StateSpace(A, np.eye(2), [[1, 1]], dt=1), 4.688371, 4.711105),
    "direct term": (StateSpace(A, np.eye(2), [[1, 1]], [[0.1, 0]], dt=1), 4.788371, 4.811105),
    "two outputs": (StateSpace(A, np.eye(2), [[1, 0], [1, 1]], dt=1), 5.185530, 5.206139),
    "alternating": (StateSpace([[-0.6]], [[1]], [[2]], [[0.5]], dt=1), 5.5, 5.5),
}


def random_system(seed: int, slowest: float = 1e-3, direct: bool = True) -> StateSpace:
    rng = np.random.default_rng(seed)
    n, m, p = int(rng.integers(1, 21)), int(rng.integers(1, 4)), int(rng.integers(1, 4))
    A = rng.standard_normal((n, n))
    A *= (1 - 10 ** rng.uniform(np.log10(slowest), -0.1)) / np.abs(np.linalg.eigvals(A)).max()
    u = 10.0 ** rng.integers(-4, 5, n) if seed % 2 else np.ones(n)  # units of states
    D = rng.standard_normal((p, m)) * (seed % 3) if direct else None
    B, C = rng.standard_normal((n, m)), rng.standard_normal((p, n))
    return StateSpace(A / u[:, None] * u, B / u[:, None], C * u, D, dt=1)


def impulse_response(s: StateSpace, count: int) -> np.ndarray:
    v = np.zeros((s.n_inputs, count, s.n_inputs))
    v[:, 0] = np.eye(s.n_inputs)
    return s.simulate(v).transpose(1, 2, 0)


@pytest.mark.parametrize("name", KNOWN)
def test_known_values(name):
    system, exact, star = KNOWN[name]
    assert peak_norm(system).value == pytest.approx(exact, abs=1e-5)
    assert peak_norm(system, kind="star").value == pytest.approx(star, abs=1e-5)


def test_parameter_of_the_star_norm_of_a_lag():
    found = peak_norm(KNOWN["lag"][0], kind="star")
    assert found.a == pytest.approx(1.25, abs=1e-4)
    # Q = a A Q A' + a / (a - 1) B B'
    assert found.ellipsoid == pytest.approx(found.a / (found.a - 1) / (1 - found.a * 0.64), rel=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_an_input_attains_it_and_no_direction_gives_more(seed):
    system = random_system(seed, slowest=0.02)
    found = peak_norm(system)
    v = peak_input(system, found, found.terms)
    assert np.linalg.norm(v, axis=1).max() <= 1 + 1e-12
    assert np.linalg.norm(system.simulate(v)[-1]) == pytest.approx(found.attained, rel=1e-7)
    assert found.attained <= found.value <= found.attained * (1 + 1e-6)
    H = impulse_response(system, 1500)
    g = np.random.default_rng(seed).standard_normal((4000, system.n_outputs))
    g /= np.linalg.norm(g, axis=1, keepdims=True)
    assert np.linalg.norm(np.einsum("kpm,gp->gkm", H, g), axis=2).sum(axis=1).max() <= found.value


@pytest.mark.parametrize("outputs", [2, 3, 4])
def test_many_local_maxima_against_all_signs(outputs):
    """With one input and ten terms it is the longest of all sums of the terms with signs."""
    h = np.random.default_rng(outputs).standard_normal((10, outputs))
    delays = StateSpace(np.eye(10, k=-1), np.eye(10)[:, :1], h.T, dt=1)
    longest = max(np.linalg.norm(np.array(s) @ h) for s in itertools.product([1, -1], repeat=10))
    assert peak_norm(delays).value == pytest.approx(longest, rel=2e-6)


def test_largest_entries():
    system = random_system(4, slowest=0.05)
    found = peak_norm(system, componentwise=True)
    assert found.value == pytest.approx(np.abs(impulse_response(system, 1500)).sum(axis=(0, 2)).max(), rel=1e-6)
    v = peak_input(system, found, found.terms)
    assert np.abs(v).max() == 1
    assert np.abs(system.simulate(v)[-1]).max() == pytest.approx(found.attained, rel=1e-7)


@pytest.mark.parametrize("pole", [1 - 1e-3, 1 - 1e-5])
def test_slow_systems(pole):
    lag = StateSpace([[pole]], [[1]], [[1 - pole]], dt=1)
    assert peak_norm(lag).value == pytest.approx(1, rel=1e-6)
    assert peak_norm(lag, kind="star").value == pytest.approx(1, rel=1e-6)


def test_states_in_any_units():
    system = random_system(2)
    u = 10.0 ** np.random.default_rng(0).integers(-8, 9, system.n_states)
    other = system.replaced(A=system.A / u[:, None] * u, B=system.B / u[:, None], C=system.C * u)
    for kind in ("exact", "star"):
        assert peak_norm(other, kind=kind).value == pytest.approx(peak_norm(system, kind=kind).value, rel=2e-6)


def check_order(seed: int, largest: int) -> None:
    system = random_system(seed, slowest=1e-4)
    exact, star = peak_norm(system, rtol=1e-5), peak_norm(system, kind="star")
    assert exact.attained <= star.value * (1 + 1e-9)
    if system.n_states > largest:
        return
    bound = peak_norm(system, kind="lmi").value
    assert exact.attained <= bound * (1 + 1e-9)
    assert bound <= star.value


@pytest.mark.parametrize("seed", range(20))
def test_order_of_the_bounds(seed):
    pytest.importorskip("clarabel")
    check_order(seed, 8)


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(20, 200))
def test_order_of_the_bounds_many(seed):
    pytest.importorskip("clarabel")
    check_order(seed, 20)


def test_inequality_weighs_the_direct_term():
    pytest.importorskip("clarabel")
    # The direct term and the states share the input of one sample: orthogonal outputs never peak together.
    system = StateSpace([[0.5]], [[1.0]], [[1.0], [0.0]], [[0.0], [2.0]], dt=1)
    star, bound = peak_norm(system, kind="star").value, peak_norm(system, kind="lmi").value
    assert star == pytest.approx(4, rel=1e-6)
    assert peak_norm(system).value == pytest.approx(np.sqrt(8), rel=1e-6)
    assert bound == pytest.approx(np.sqrt(8), rel=1e-3)


def test_static_and_zero_systems():
    static = StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), [[3, 4], [0, 0]], dt=1)
    assert peak_norm(static).value == pytest.approx(5)
    assert peak_norm(static, kind="star").value == pytest.approx(5)
    silent = StateSpace([[0.5]], [[0.0]], [[1.0]], dt=1)
    assert peak_norm(silent).value == peak_norm(silent, kind="star").value == 0


@trips("linear.norms.peak_norm:_too_slow")
def test_bad_requests():
    lag = KNOWN["lag"][0]
    with pytest.raises(ModelError, match=r"sample it first, system\.discretize"):
        peak_norm(StateSpace([[-1.0]], [[1]], [[1]]))
    with pytest.raises(ModelError, match=r"unstable pole 1\.01"):
        peak_norm(StateSpace([[1.01]], [[1]], [[1]], dt=1), kind="star")
    with pytest.raises(SettingError, match="'exact', 'star', 'lmi'"):
        peak_norm(lag, kind="norm")
    with pytest.raises(SettingError, match="kind='exact'"):
        peak_norm(lag, kind="star", componentwise=True)
    with pytest.raises(AccuracyError, match=r"after \d+ terms .* kind='star'"):
        peak_norm(StateSpace([[1 - 1e-9]], [[1]], [[1]], dt=1), most_terms=10_000)
    with pytest.raises(SettingError, match="direction"):
        peak_input(lag, peak_norm(lag, kind="star"), 5)


def test_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "clarabel", None)
    with pytest.raises(MissingExtraError, match=r"residua\[lmi\]"):
        peak_norm(KNOWN["lag"][0], kind="lmi")


def stepped_sum(A, B, C, D, count):
    """The sum of the lengths of the impulse response, one step after the other."""
    total, x = np.linalg.norm(D), B
    for _ in range(count):
        total, x = total + np.linalg.norm(C @ x), A @ x
    return total


@pytest.mark.refusals(at_most=0)
def test_squares_of_matrices_far_from_normal_are_not_relied_on(refused: Refused):
    """Poles near to each other: products with powers of A are off by more than any tolerance, steps are not."""
    for seed in range(60):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(3, 7))
        coefficients = np.poly(0.75 + 0.15 * rng.random(n))
        A = np.diag(np.ones(n - 1), 1)
        A[-1] = -coefficients[1:][::-1]
        Q, _ = np.linalg.qr(rng.standard_normal((n, n)))
        A, B, C = Q @ A @ Q.T, Q[:, -1:], Q[:, 0][None]
        try:
            found = peak_norm(StateSpace(A, B, C, dt=1.0))
        except (AccuracyError, ModelError) as error:
            refused(error)
            continue
        assert found.value == pytest.approx(stepped_sum(A, B, C, np.zeros((1, 1)), 3000), rel=2e-6), seed


@pytest.mark.parametrize("coupling", [1e-3, 1.0, 1e2, 1e5])
def test_triangles_bound_the_tail(coupling):
    A = np.diag([0.9, 0.9, 0.9, 0.2]) + coupling * np.diag([1.0, 1.0, 1.0], 1)
    Q, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((4, 4)))
    A = Q @ A @ Q.T
    system = StableSystem(A, np.eye(4), np.eye(4), np.zeros((4, 4)), np.ones(4), 0.9)
    if coupling > 1e3:
        with pytest.raises(AccuracyError, match="no norm was found"):
            impulse_terms._by_triangle(system)
        return
    bound = impulse_terms._by_triangle(system)
    for X in (np.eye(4), Q[:, :1]):
        exact, x = 0.0, X
        for _ in range(600):
            exact, x = exact + np.linalg.norm(x, 2), A @ x
        assert exact <= bound(X) <= 40 * exact
