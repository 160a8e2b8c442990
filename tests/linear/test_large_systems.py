"""What is computed otherwise for larger systems is what the definition says, to the last digits."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from scipy.sparse.csgraph import connected_components

from residua.errors import ModelError
from residua.linear import StateSpace
from residua.linear.poles import riccati
from residua.linear.poles.riccati import filter_covariance
from residua.linear.subspaces.parts import connected_parts, strong_parts

KINDS = ("full", "chain", "blocks", "graded")
POINTS = 1j * np.array([0.03, 0.7, 5.0, 90.0])


def system(kind: str, n: int = 40, seed: int = 0) -> StateSpace:
    rng = np.random.default_rng([seed, n])
    A = rng.standard_normal((n, n)) / np.sqrt(n) - 1.3 * np.eye(n)
    if kind == "chain":
        A = np.diag(-rng.uniform(0.5, 3, n)) + np.diag(rng.uniform(0.2, 1.5, n - 1), -1)
    elif kind == "blocks":
        A = np.where(np.arange(n)[:, None] % 3 == np.arange(n) % 3, A, 0.0)
    elif kind == "graded":
        size = np.logspace(0, -6, n)
        A *= np.sqrt(size[:, None] * size)
    B, C = rng.standard_normal((n, 3)), rng.standard_normal((2, n))
    if kind == "chain":  # from the first state to the last
        B, C = np.eye(n)[:, :1], np.eye(n)[-1:]
    return StateSpace(A, B, C)


def exact(of: StateSpace) -> np.ndarray:
    """Return the responses by elimination with 64 bits, where the platform has them, and two refinements."""
    out = []
    for s in POINTS:
        M = (np.clongdouble(s) * np.eye(of.n_states, dtype=np.longdouble) - of.A.astype(np.longdouble)).copy()
        X = eliminated(M, of.B.astype(np.clongdouble))
        X = X + eliminated(M, of.B - M @ X)
        out.append(of.C.astype(np.longdouble) @ X + of.D)
    return np.array(out)


def eliminated(M: np.ndarray, right: np.ndarray) -> np.ndarray:
    whole, n = np.hstack([M, right]), len(M)
    for k in range(n):
        pivot = k + int(np.abs(whole[k:, k]).argmax())
        whole[[k, pivot]] = whole[[pivot, k]]
        whole[k + 1 :] -= np.outer(whole[k + 1 :, k] / whole[k, k], whole[k])
    for k in reversed(range(n)):
        whole[k, n:] = (whole[k, n:] - whole[k, k + 1 : n] @ whole[k + 1 :, n:]) / whole[k, k]
    return whole[:, n:]


@pytest.mark.parametrize("kind", KINDS)
def test_responses_of_larger_systems_are_exact_to_the_rounding_of_their_terms(kind):
    of = system(kind, n=33)
    wanted, found = exact(of), of.evaluate(POINTS)
    size = np.abs(wanted) if kind == "chain" else np.abs(wanted).max(axis=(1, 2), keepdims=True)
    assert np.all(np.abs(found - wanted) <= 1e-12 * size)
    if kind == "chain":  # elimination keeps what is far smaller than the rounding of other entries
        assert np.abs(wanted).min() < 1e-40


def test_parts_that_nothing_couples_are_found_whatever_their_order():
    rng = np.random.default_rng(1)
    order = rng.permutation(40)
    coupled = scipy.linalg.block_diag(*(np.tri(k) for k in (1, 5, 12, 22)))[np.ix_(order, order)] > 0
    parts = connected_parts(coupled)
    assert sorted(len(part) for part in parts) == [1, 5, 12, 22]
    assert [part[0] for part in parts] == sorted(part[0] for part in parts)
    for part in parts:
        assert not coupled[np.ix_(part, np.setdiff1d(np.arange(40), part))].any()
    assert connected_parts(np.zeros((0, 0), dtype=bool)) == []


def test_stacked_systems_respond_as_their_members_do():
    members = [system("full", 12, seed) for seed in range(4)]
    stacked = members[0]
    for member in members[1:]:
        stacked = stacked.append(member)
    whole, parts = stacked.evaluate(POINTS), [member.evaluate(POINTS) for member in members]
    for k, part in enumerate(parts):
        assert np.allclose(whole[:, 2 * k : 2 * k + 2, 3 * k : 3 * k + 3], part, rtol=1e-13)
    assert np.count_nonzero(whole) == sum(part.size for part in parts)


def test_a_pole_at_a_point_is_said_of_larger_systems_too():
    of = system("full", 40)
    A = scipy.linalg.block_diag(of.A, [[0.0]])
    integrating = StateSpace(A, np.vstack([of.B, np.ones((1, 3))]), np.hstack([of.C, np.ones((2, 1))]))
    with pytest.raises(ModelError, match="pole at one of the points"):
        integrating.dc_gain()


def filter_problem(n: int, dt: float, *, cross: bool) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng([n, int(dt > 0)])
    of = system("full", n)
    A = scipy.linalg.expm(of.A * dt) if dt else of.A
    S = 0.05 * rng.standard_normal((n, 2)) if cross else np.zeros((n, 2))
    return A, np.asarray(of.C), np.eye(n) + 0.1 * np.ones((n, n)), np.diag([1.0, 4.0]), S


@pytest.mark.parametrize("cross", [False, True])
@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("n", [32, 70])
def test_doubling_gives_the_covariance_of_the_qz_algorithm(n, dt, cross, monkeypatch):
    terms = filter_problem(n, dt, cross=cross)
    P = riccati._by_doubling(*terms, dt)
    assert P is not None
    assert np.array_equal(P, filter_covariance(*terms, dt=dt))
    monkeypatch.setattr(riccati, "_STATES", 1000)
    other = filter_covariance(*terms, dt=dt)
    assert np.linalg.norm(P - other) <= 1e-10 * np.linalg.norm(other)


def test_the_solution_is_the_stabilising_one_where_no_noise_reaches_an_unstable_state(monkeypatch):
    A, C, Q, R, _ = filter_problem(40, 0.0, cross=False)
    A, Q = scipy.linalg.block_diag(A, [[0.5]]), scipy.linalg.block_diag(Q, [[0.0]])
    C = np.hstack([C, np.ones((2, 1))])
    P = filter_covariance(A, C, Q, R, dt=0.0)
    assert np.linalg.eigvals(A - P @ C.T @ np.linalg.inv(R) @ C).real.max() < 0
    monkeypatch.setattr(riccati, "_STATES", 1000)
    assert np.allclose(P, filter_covariance(A, C, Q, R, dt=0.0), rtol=1e-8, atol=1e-8)


def test_what_doubling_does_not_solve_is_left_to_the_qz_algorithm(monkeypatch):
    A, C, Q, R, S = filter_problem(40, 0.0, cross=False)
    monkeypatch.setattr(riccati, "_MOST", 1)  # the start is not forgotten
    assert riccati._by_doubling(A, C, Q, R, S, 0.0) is None
    monkeypatch.setattr(riccati, "_MOST", 60)
    monkeypatch.setattr(riccati, "_RESIDUAL", 0.0)
    assert riccati._by_doubling(A, C, Q, R, S, 0.0) is None
    assert np.array_equal(filter_covariance(A, C, Q, R, dt=0.0), scipy.linalg.solve_continuous_are(A.T, C.T, Q, R))


def test_states_respond_as_through_the_identity():
    a = system("full")
    X = StateSpace(a.A, a.B, np.eye(40)).evaluate(POINTS)
    np.testing.assert_allclose(a.C @ X + a.D, a.evaluate(POINTS), rtol=1e-12, atol=1e-14)
    turned = np.roll(np.eye(40), 1, axis=0)  # has the entries of the identity, elsewhere
    np.testing.assert_allclose(StateSpace(a.A, a.B, turned).evaluate(POINTS), np.roll(X, 1, axis=1), rtol=1e-12)


def test_strong_parts_are_those_of_scipy():
    rng = np.random.default_rng(4)
    for n, share in [(int(rng.integers(0, 9)), rng.choice([0.3, 1.0])) for _ in range(100)] + [(40, 0.02), (40, 0.1)]:
        A = rng.standard_normal((n, n)) * (rng.random((n, n)) < share)
        count, part = connected_components(A != 0, connection="strong")
        wanted = sorted(np.flatnonzero(part == i).tolist() for i in range(count))
        assert [p.tolist() for p in strong_parts(A)] == wanted
