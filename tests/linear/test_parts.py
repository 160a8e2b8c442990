"""Parts that nothing connects are computed apart, and what rounding scatters counts as what it was."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from residua.design.core.signatures import _dimension
from residua.linear import invariant_zeros
from residua.linear.poles.zero_structure import explicit_poles
from residua.linear.polynomials.polynomial_basis import basis_on_poles
from residua.linear.subspaces.parts import row_parts
from residua.robust.parity.optimal_parity import best_ratios


@pytest.mark.parametrize("seed", range(20))
def test_rows_of_different_parts_share_no_column_and_those_of_one_are_connected(seed: int) -> None:
    rng = np.random.default_rng(seed)
    M = rng.random((int(rng.integers(1, 8)), int(rng.integers(1, 8)))) < 0.25
    parts = row_parts(M)
    assert sorted(np.concatenate(parts).tolist()) == list(range(len(M)))
    for i, part in enumerate(parts):
        rest = np.concatenate([np.zeros(0, dtype=int), *(other for j, other in enumerate(parts) if j != i)])
        assert not np.any(M[part].any(axis=0) & M[rest].any(axis=0))
        if len(part) > 1:  # no row of it is alone, and no two halves of it are
            for cut in range(1, 2 ** (len(part) - 1)):
                one = part[[bool(cut >> k & 1) for k in range(len(part))]]
                other = np.setdiff1d(part, one)
                assert np.any(M[one].any(axis=0) & M[other].any(axis=0))


def test_equal_ratios_of_rows_without_a_common_signal_are_not_combined() -> None:
    ratios, rows = best_ratios(np.diag([2.0, 1e-6]), np.diag([1.0, 5e-7]), 2)
    np.testing.assert_allclose(ratios, [2.0, 2.0])
    np.testing.assert_array_equal(np.abs(rows) > 0, np.eye(2, dtype=bool))


def test_where_ratios_are_equal_the_basis_of_the_rows_chooses_nothing() -> None:
    """Three equal sensors beside a fourth: the best relations see each fault alike, in a space of two dimensions."""
    space = np.linalg.qr(np.array([[1.0, -1, 0, 0], [0, 1, -1, 0], [0, 0, 1, -1]]).T)[0].T
    found = []
    for seed in range(4):
        turned = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0] @ space
        ratios, rows = best_ratios(turned[:, :3], turned, 3)
        np.testing.assert_allclose(ratios, [1, 1, 0.5])
        found.append(np.abs(rows @ turned))
    np.testing.assert_allclose(found[0][0] * np.sqrt(1.5), [1, 0.5, 0.5, 0], atol=1e-12)
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], atol=1e-12)


def test_combinations_within_a_part_are_the_best_ones() -> None:
    rng = np.random.default_rng(4)
    F, D = rng.normal(size=(3, 4)), rng.normal(size=(3, 5))
    ratios, rows = best_ratios(F, D, 3)
    for r, c in zip(ratios, rows, strict=True):
        np.testing.assert_allclose(np.linalg.norm(c @ F) / np.linalg.norm(c @ D), r)
    assert all(np.linalg.norm(c @ F) <= ratios[0] * np.linalg.norm(c @ D) for c in rng.normal(size=(200, 3)))


def test_the_scatter_of_poles_that_meet_is_no_size() -> None:
    basis = basis_on_poles(np.full(4, -1.0), 6, 2.5)
    assert basis.sizes.tolist() == [2.5] * 6
    assert basis.real.tolist() == [-1.0] * 6


@pytest.mark.parametrize("seed", range(6))
def test_no_pole_of_a_regular_matrix_far_from_normal_is_zero(seed: int) -> None:
    """Rounding moves the poles of long chains by more than they are, and yet no rounding makes the matrix singular."""
    rng, n = np.random.default_rng([seed, 16]), 60
    chain = -1.5 * np.eye(n) + np.diag(rng.uniform(0.8, 1.0, n - 1), -1)
    chain += np.diag(rng.uniform(0.1, 0.3, n - 1), 1) if seed % 2 else np.diag(rng.uniform(0.8, 1.0, 1), n - 1)
    sampled = scipy.linalg.expm(0.2 * chain)
    for A in (chain, sampled):
        assert np.all(explicit_poles(A) != 0)
        A = np.block([[A, np.zeros((n, 1))], [np.ones((1, n)), np.zeros((1, 1))]])  # and one that sums the states up
        assert np.count_nonzero(explicit_poles(A) == 0) == 1


def test_invariant_zeros_at_the_origin_are_a_cluster_there() -> None:
    # x1' = x2, x2' = x3, x3' = -x1 - 2 x2 - 3 x3 + u, and the acceleration of the first is measured: s^2 over ...
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, -2.0, -3.0]])
    T = np.array([[1.0, 2.0, -1.0], [0.0, 1.0, 3.0], [2.0, 0.0, 1.0]])
    found = invariant_zeros(T @ A @ np.linalg.inv(T), T @ [[0.0], [0.0], [1.0]], [[0.0, 0.0, 1.0]] @ np.linalg.inv(T))
    (cluster,) = found.clusters
    assert cluster.count == len(found.zeros) == 2
    assert abs(cluster.center) < 1e-12
    assert cluster.radius < 1e-6


@pytest.mark.parametrize(
    ("sizes", "count"),
    [
        ([1.0, 0.3, 1e-2], 3),
        ([1.0, 1e-9, 1e-16], 1),  # what a design misses
        ([1.0, 1e-7, 1e-16], 1),
        ([1.0, 2e-3, 2e-8, 1e-18], 3),  # faint, and far above what rounding is
        ([1.0, 2e-3, 2e-8, 1e-10], 2),
        ([1.0, 2e-3, 2e-11, 1e-18], 2),
    ],
)
def test_a_faint_direction_counts_where_rounding_is_much_fainter(sizes: list[float], count: int) -> None:
    assert _dimension(np.array(sizes), 1e-6) == count
