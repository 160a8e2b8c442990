"""Newton's basis and rows that annihilate pairs: against values at points, and where powers lose their digits."""

from __future__ import annotations

import numpy as np
import pytest

from residua.design.parity.relation import pole_basis
from residua.linear.polynomials.common_factor import without_common_factor
from residua.linear.polynomials.pair_relations import PairRelations
from residua.linear.polynomials.polynomial_basis import PolynomialBasis


def random_nodes(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return nodes in the unit disc, closed under conjugation."""
    pairs = int(rng.integers(0, count // 2 + 1))
    upper = rng.uniform(-0.7, 0.7, pairs) + 1j * rng.uniform(0.05, 0.7, pairs)
    return np.concatenate([rng.uniform(-0.95, 0.95, count - 2 * pairs), upper, upper.conj()])


@pytest.mark.parametrize("seed", range(20))
def test_elements_are_products_over_the_nodes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    nodes = random_nodes(rng, int(rng.integers(1, 9)))
    basis = PolynomialBasis.on(nodes)
    z = 1.3 * np.exp(1j * np.linspace(0.1, 3, 9))
    last = basis.values(z, basis.count)[:, -1]
    product = np.prod([z - node for node in nodes], axis=0) / np.prod(basis.sizes)
    assert np.allclose(last, product, rtol=1e-12)
    assert np.abs(basis.values(nodes, basis.count)[:, :-1]).max() < 10  # near one on the nodes


@pytest.mark.parametrize("seed", range(20))
def test_changing_the_basis_and_multiplying_by_the_variable(seed: int) -> None:
    rng = np.random.default_rng(seed)
    k = int(rng.integers(1, 7))
    first = PolynomialBasis.on(random_nodes(rng, k + 1))
    second = PolynomialBasis.on(random_nodes(rng, k + 1)) if seed % 2 else PolynomialBasis.powers(k + 1, 0.7)
    x = rng.standard_normal((k + 1, 2))
    z = np.exp(1j * np.linspace(0.1, 3, 9))
    value = first.values(z, k) @ x
    assert np.allclose(second.values(z, k) @ first.changed_to(second, x), value, rtol=1e-8, atol=1e-8)
    assert np.allclose(first.values(z, k + 1) @ first.times_variable(x), z[:, None] * value, rtol=1e-10)


def test_a_basis_without_room_says_so() -> None:
    with pytest.raises(ValueError, match="2 nodes"):
        PolynomialBasis.powers(2).times_variable(np.ones((3, 1)))


def cluster(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a chain of slow lags and its last state as output: observable, of order n, all poles near one."""
    poles = 1 - np.linspace(0.01, 0.03, n)
    return np.diag(poles) + np.diag(np.full(n - 1, 0.02), -1), np.eye(n)[-1:]


def without_inputs(A: np.ndarray, C: np.ndarray) -> PairRelations:
    return PairRelations.of(A, np.zeros((len(A), 0)), C, np.zeros((len(C), 0)))


def missed(A: np.ndarray, C: np.ndarray, p: np.ndarray, q: np.ndarray, basis: PolynomialBasis) -> float:
    """Return how far a row is from ``p (zI - A) = q C``, at points around the nodes, relative to its terms."""
    points = 2 * max(1.0, np.abs(basis.real).max()) * np.exp(1j * np.linspace(0.1, 3, 7))
    N = basis.values(points, len(q) - 1)
    left, right = np.einsum("wi,wij->wj", N @ p, points[:, None, None] * np.eye(len(A)) - A), N @ q @ C
    terms = np.abs(left).max() + np.abs(right).max() + np.abs(q).max() * np.abs(C).max()
    return float(np.abs(left - right).max() / terms)


@pytest.mark.parametrize("n", [4, 8, 12, 16, 20])
def test_the_order_of_slow_chains_is_found_on_their_poles(n: int) -> None:
    A, C = cluster(n)
    relations = without_inputs(A, C)
    assert relations.orders == (n, n)
    basis = relations.basis(n)
    (p,), (q,), _ = relations.rows(n, basis)
    assert np.abs(q).argmax() == n
    assert missed(A, C, p, q, basis) < 1e-13
    poles = pole_basis(np.full(n, 0.95, dtype=complex), 0.02)
    assert missed(A, C, *relations.moved(p, q, basis, poles), poles) < 1e-12


@pytest.mark.parametrize("seed", range(20))
def test_rows_are_as_many_as_the_indices_say_and_annihilate(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m, d = int(rng.integers(2, 7)), int(rng.integers(2, 4)), int(rng.integers(0, 2))
    A, B, C = rng.standard_normal((n, n)), rng.standard_normal((n, d)), rng.standard_normal((m, n))
    relations = PairRelations.of(A, B, C, np.zeros((m, d)))
    low, more = divmod(n - d if d else n, m - d)  # indices of a generic pair: d states are known from outputs
    indices = [low + 1] * more + [low] * (m - d - more)
    for order in range(n + 2):
        if d == 0:
            assert relations.count(order) == sum(max(order - index + 1, 0) for index in indices)
        basis, powers = relations.basis(order), PolynomialBasis.powers(order + 1)
        p, q, decision = relations.rows(order, basis)
        assert len(p) == relations.count(order) == (order + 1) * len(relations.pair[1]) - decision.rank
        for one in zip(p, q, strict=True):
            assert missed(A, C, *one, basis) < 1e-12
            assert np.abs(one[0] @ B).max(initial=0.0) < 1e-13
            assert missed(A, C, *relations.moved(*one, basis, powers), powers) < 1e-10


def test_one_pole_that_rounding_scatters_is_one_node() -> None:
    A = np.array([[-2.0, 1, 0], [-1, -2, 1], [0, 1, -2]])  # nilpotent but for the pole at -2
    basis = without_inputs(A, np.eye(3)[:1]).basis(3)
    assert basis.real.tolist() == [-2.0] * 4
    assert basis.sizes.tolist() == [1.0] * 4


def test_modes_far_from_the_nodes_hide_no_others() -> None:
    """Powers of an eigenvalue of 26 beside those of 0.1: orthogonal in each step, and exact to rounding."""
    rng = np.random.default_rng(3)
    T = np.linalg.qr(rng.standard_normal((10, 10)))[0]
    A = T @ np.diag([26.0, -20, 0.9, 0.7, 0.5, 0.3, 0.1, -0.2, -0.4, 0.05]) @ T.T
    C = rng.standard_normal((1, 10)) @ T.T
    relations, powers = without_inputs(A, C), PolynomialBasis.powers(11)
    (p,), (q,), _ = relations.rows(10, powers)
    assert missed(A, C, p, q, powers) < 1e-13


@pytest.mark.parametrize("seed", range(20))
def test_a_common_factor_in_any_basis(seed: int) -> None:
    rng = np.random.default_rng(seed)
    k, common = int(rng.integers(0, 5)), int(rng.integers(0, 3))
    basis = PolynomialBasis.on(random_nodes(rng, k + common + 1))
    z = np.exp(1j * np.linspace(0.05, 3.1, 40))
    roots = rng.uniform(-0.9, 0.9, common)
    left = rng.standard_normal((k + 1, 3))
    value = (basis.values(z, k) @ left) * np.prod([z - r for r in roots], axis=0).reshape(-1, 1) if common else None
    value = basis.values(z, k) @ left if value is None else value
    N = basis.values(z, k + common)
    x = np.linalg.lstsq(np.vstack([N.real, N.imag]), np.vstack([value.real, value.imag]), rcond=None)[0]
    found, zeros, error = without_common_factor(np.asarray(x, dtype=np.float64), basis)
    assert np.allclose(np.sort(zeros.real), np.sort(roots), atol=1e-5)
    assert len(found) == k + 1
    assert error < 1e-9
    assert np.allclose(basis.values(z, k) @ found, basis.values(z, k) @ left, rtol=1e-6, atol=1e-7)
