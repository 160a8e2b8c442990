"""Newton's basis and null vectors of pencils: against values at points, and where powers lose their digits."""

from __future__ import annotations

import numpy as np
import pytest

from residua.linear.polynomials.common_factor import without_common_factor
from residua.linear.polynomials.pencil_null_space import (
    Pencil,
    pencil,
    pencil_null_vectors,
    refined,
    shortest_pencil_null_vectors,
)
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
    assert PolynomialBasis.on([]).with_room().count == 1
    assert PolynomialBasis.on([0.3, 0.5]).with_room().count == 3


def cluster(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a chain of slow lags and its last state as output: observable, of order n, all poles near one."""
    poles = 1 - np.linspace(0.01, 0.03, n)
    return np.diag(poles) + np.diag(np.full(n - 1, 0.02), -1), np.eye(n)[-1:]


@pytest.mark.parametrize("n", [4, 8, 12, 16, 20])
def test_the_order_of_slow_chains_is_found_on_their_poles(n: int) -> None:
    A, C = cluster(n)
    P0, P1 = np.vstack([-A, -C]), np.vstack([np.eye(n), np.zeros((1, n))])
    given = pencil(P0, P1, PolynomialBasis.on(np.linalg.eigvals(A)).with_room())
    found = shortest_pencil_null_vectors(given, most=n)
    assert found is not None
    assert found.degree == n
    assert len(found.vectors) == 1
    x = found.vectors[0]
    d = np.abs(x[:, n]) / np.abs(x[:, n]).max()
    assert d[-1] == 1
    assert d[:-1].max() < (1e-8 if n < 16 else 1e-3)
    assert np.abs(given.products(x)).max() < 1e-13 * np.abs(x).max()


@pytest.mark.parametrize("seed", range(10))
def test_null_vectors_of_a_random_pencil(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(2, 6)), int(rng.integers(2, 4))
    A, C = rng.standard_normal((n, n)), rng.standard_normal((m, n))
    A /= np.abs(np.linalg.eigvals(A)).max()
    given = pencil(
        np.vstack([-A, -C]),
        np.vstack([np.eye(n), np.zeros((m, n))]),
        PolynomialBasis.on(np.append(np.linalg.eigvals(A), 0.1)),
    )
    z = np.exp(1j * np.linspace(0.1, 3, 7))
    for degree in range(n + 1):
        found = pencil_null_vectors(given, degree)
        low, more = divmod(n, m)  # observability indices of a generic pair
        indices = [low + 1] * more + [low] * (m - more)
        assert len(found.vectors) == sum(max(degree - index + 1, 0) for index in indices)
        N = given.basis.values(z, degree)
        P = given.P0 + z[:, None, None] * given.P1
        for x in found.vectors:
            assert np.abs(np.einsum("wi,wij->wj", N @ x, P)).max() < 1e-12
        if len(found.vectors):
            x = found.vectors[0]
            moved = x + 1e-6 * rng.standard_normal(x.shape)
            back = refined(given, moved)
            assert np.abs(given.products(back)).max() < 1e-12
            assert np.abs(back - x).max() < 1e-4


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
    found, zeros, error = without_common_factor(x, basis)
    assert np.allclose(np.sort(zeros.real), np.sort(roots), atol=1e-5)
    assert len(found) == k + 1
    assert error < 1e-9
    assert np.allclose(basis.values(z, k) @ found, basis.values(z, k) @ left, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("seed", range(8))
def test_large_pencils_have_the_null_vectors_of_a_full_decomposition(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng([seed, 8])
    n, m = int(rng.integers(6, 14)), int(rng.integers(1, 4))
    A, C = rng.standard_normal((n, n)), rng.standard_normal((m, n))
    A /= np.abs(np.linalg.eigvals(A)).max()
    if seed % 2:  # two parts without a common unit
        A[: n // 2, n // 2 :] = A[n // 2 :, : n // 2] = 0
        C[0, n // 2 :] = 0
        C[1:, : n // 2] = 0
    poles = np.linalg.eigvals(A)
    problem = pencil(
        np.vstack([-A, -C]), np.vstack([np.eye(n), np.zeros((m, n))]), PolynomialBasis.on(poles).with_room()
    )
    whole = shortest_pencil_null_vectors(problem, most=n)
    monkeypatch.setattr("residua.linear.polynomials.pencil_null_space._DENSE", 0)
    made = shortest_pencil_null_vectors(problem, most=n)
    assert whole is not None
    assert made is not None
    assert made.vectors.shape == whole.vectors.shape
    assert made.decision.smallest_kept == pytest.approx(whole.decision.smallest_kept, rel=0.01)
    assert made.decision.largest_dropped < 1e-14
    assert made.decision.rank == whole.decision.rank
    assert made.decision.dropped.size == made.vectors.shape[1] * (n + m) - whole.decision.rank
    assert np.allclose(made.units, whole.units)
    first, second = (
        np.linalg.qr((one.vectors / one.units).reshape(len(one.vectors), -1).T)[0] for one in (whole, made)
    )
    assert np.linalg.norm(first - second @ (second.T @ first), 2) < 1e-10
    moved = whole.vectors[0] + 1e-6 * rng.standard_normal(whole.vectors[0].shape) * whole.units
    back = refined(problem, moved)
    assert np.abs(problem.products(back)).max() < 1e-13 * np.abs(back).max()
    assert np.abs((back - whole.vectors[0]) / whole.units).max() < 1e-4
    short = whole.degree - 1
    if short >= 0:
        assert shortest_pencil_null_vectors(problem, most=short) is None


def of_poles(poles: np.ndarray, C: np.ndarray) -> Pencil:
    """Return the pencil of relations of independent states with these poles, all driven alike."""
    n, m = len(poles), len(C)
    P0, P1 = np.vstack([-np.diag(poles), -C]), np.vstack([np.eye(n), np.zeros((m, n))])
    return pencil(P0, P1, PolynomialBasis.on(poles).with_room())


@pytest.mark.parametrize(
    "outputs",
    [np.ones((1, 6)), np.vstack([np.ones((2, 6)), np.zeros((1, 6))]), np.arange(90.0).reshape(15, 6) % 7 - 3],
    ids=["one", "one dead", "more than states"],
)
@pytest.mark.parametrize("degree", [6])
def test_large_bands_with_rows_of_nothing_or_many_null_vectors(
    outputs: np.ndarray, degree: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = of_poles(-np.arange(1.0, 7.0), outputs)
    whole = pencil_null_vectors(problem, degree)
    monkeypatch.setattr("residua.linear.polynomials.pencil_null_space._DENSE", 0)
    made = pencil_null_vectors(problem, degree)
    assert made.vectors.shape == whole.vectors.shape
    assert made.decision.rank == whole.decision.rank
    assert made.decision.kept.size == made.decision.rank - made.decision.omitted
    values = np.linalg.svd((made.vectors / made.units).reshape(len(made.vectors), -1), compute_uv=False)
    assert np.allclose(values, 1.0)
    for one in made.vectors:
        assert np.abs(problem.products(one)).max() < 1e-12 * np.abs(one).max()


@pytest.mark.parametrize("seed", [15, 3])
def test_stiff_pencils_are_not_said_to_have_none(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lower degrees have units of their own: judged in those of a higher one there was a vector, and then none."""
    monkeypatch.setattr("residua.linear.polynomials.pencil_null_space._DENSE", 0)
    poles = -np.logspace(-3.75, 3.75, 24)
    made = shortest_pencil_null_vectors(of_poles(poles, np.random.default_rng(seed).standard_normal((1, 24))), most=24)
    assert made is not None
    assert len(made.vectors)


def test_an_iteration_that_does_not_settle_ends_with_the_whole_decomposition(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("residua.linear.polynomials.pencil_null_space._DENSE", 0)
    problem = of_poles(-np.arange(1.0, 7.0), np.ones((2, 6)))
    settled = pencil_null_vectors(problem, 6)
    monkeypatch.setattr("residua.linear.polynomials.banded_null_space._STEPS", 1)
    made = pencil_null_vectors(problem, 6)
    assert made.vectors.shape == settled.vectors.shape
    assert made.decision.smallest_kept == pytest.approx(settled.decision.smallest_kept, rel=1e-3)  # as it settles
