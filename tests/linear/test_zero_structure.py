"""Zeros and poles at zero: as many as there are, in whatever units, and the others as they were."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from residua.linear import StateSpace, invariant_zeros
from residua.linear.poles.spectrum import match_poles
from residua.linear.poles.zero_structure import explicit_poles, without_zero_eigenvalues


def chains(rng, lengths, others):
    """Return a matrix with chains of integrators of these lengths and further poles, in random coordinates."""
    blocks = [np.diag(2.0 ** rng.integers(-3, 4, k - 1), 1) for k in lengths]
    A = scipy.linalg.block_diag(*blocks, *others)
    Q = np.linalg.qr(rng.normal(size=A.shape))[0]
    return Q @ A @ Q.T


@pytest.mark.parametrize("seed", range(20))
def test_chains_of_integrators_have_all_their_poles_at_zero_and_nothing_else_has(seed):
    rng = np.random.default_rng(seed)
    lengths = [int(k) for k in rng.integers(1, 6, rng.integers(1, 4))]
    others = np.sign(rng.normal(size=3)) * 10.0 ** rng.uniform(-6, 0, 3)  # a double zero is scattered by as much
    A = chains(rng, lengths, others)
    poles = explicit_poles(A)
    assert np.count_nonzero(poles == 0) == sum(lengths)
    np.testing.assert_allclose(np.sort(poles[poles != 0].real), np.sort(others), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_a_pencil_keeps_its_other_eigenvalues(seed):
    rng = np.random.default_rng(seed)
    A = chains(rng, [3, 2], [-1.0, 2.0])
    T = rng.normal(size=A.shape) + 3 * np.eye(7)
    rest, E, count = without_zero_eigenvalues(T @ A, T, float(np.linalg.norm(T @ A)))
    assert count == 5
    np.testing.assert_allclose(np.sort(scipy.linalg.eigvals(rest, E).real), [-1, 2], rtol=1e-9)


def test_a_long_chain_of_integrators_has_all_its_poles_at_zero():
    n = 120
    Q = np.linalg.qr(np.random.default_rng(0).normal(size=(n, n)))[0]
    assert not explicit_poles(Q @ np.diag(np.ones(n - 1), 1) @ Q.T).any()


def test_a_matrix_that_is_singular_by_rounding_alone_has_no_pole_at_zero():
    """Far from normal, with both poles at one: singular values differ by more digits than a float has."""
    A = np.eye(2) + 2.0**24 * np.array([[1, -1], [1, -1]])
    values = np.linalg.svd(A, compute_uv=False)
    assert values[-1] < 1e-14 * values[0]
    np.testing.assert_allclose(explicit_poles(A), 1, atol=0.3)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("algebraic", [0, 2])
def test_poles_of_descriptor_systems_at_zero_are_zero(seed, algebraic):
    rng = np.random.default_rng(seed)
    A = scipy.linalg.block_diag(chains(rng, [3], [-1.0, 2.0]), np.eye(algebraic))
    n = len(A)
    L, R = (rng.normal(size=(n, n)) + 3 * np.eye(n) for _ in range(2))
    E = L @ np.diag([1.0] * 5 + [0.0] * algebraic) @ R
    poles = StateSpace(L @ A @ R, np.zeros((n, 0)), np.zeros((0, n)), E=E).poles()
    assert np.count_nonzero(poles == 0) == 3
    np.testing.assert_allclose(np.sort(poles[poles != 0].real), [-1, 2], rtol=1e-9)


def test_a_pole_that_is_rounding_of_its_terms_is_zero():
    """``det(sE - A) = 3e9 s``: the size of a pole of 1e-16 would be that of the dynamics."""
    poles = StateSpace([[-3e4, -3e9], [-3, -3e5]], np.zeros((2, 0)), np.zeros((0, 2)), E=[[1e4, 0], [0, 0]]).poles()
    np.testing.assert_array_equal(poles, [0])


@pytest.mark.parametrize("factor", [2.0**-20, 2.0**-7, 2.0**13])
@pytest.mark.parametrize("seed", range(10))
def test_poles_and_zeros_are_the_same_in_whatever_unit_of_time(seed, factor):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    A = rng.integers(-3, 4, (n, n)) * (rng.random((n, n)) < 0.6)
    np.fill_diagonal(A, 0 if seed % 2 else A.diagonal())
    B, C = rng.integers(-3, 4, (n, 1)), rng.integers(-3, 4, (1, n))
    T = 2.0 ** rng.integers(-20, 21, n)
    B, C = B / T[:, None], 2.0**9 * C * T
    scaled = A / T[:, None] * T
    found, wanted = explicit_poles(factor * scaled), factor * explicit_poles(A.astype(float))
    assert np.count_nonzero(found == 0) == np.count_nonzero(wanted == 0)
    np.testing.assert_allclose(found[match_poles(wanted, found)], wanted, rtol=1e-6)
    here, there = invariant_zeros(scaled, B, C), invariant_zeros(factor * scaled, factor * B, C)
    assert here.normal_rank == there.normal_rank
    np.testing.assert_allclose(there.zeros, factor * here.zeros, rtol=1e-6)


def test_a_weak_coupling_neither_scatters_zeros_nor_is_lost_among_them():
    """The numerators are ``s^4 - 2.5e-5 s^2`` and ``3 s^4 + 2.5e-5 s^3``."""
    C = [[0.0, 0, -1, 0, 1]]
    zeros = invariant_zeros(np.diag([2.0, 1, 2.5e-5, 1], 1), np.eye(5)[:, -1:], C).zeros
    np.testing.assert_allclose(np.sort(zeros.real), [-0.005, 0, 0, 0.005], rtol=1e-9, atol=1e-9)
    B = [[0.0], [0], [3], [2.5e-5], [0]]
    zeros = invariant_zeros(np.diag([1.0, 2, 1, 1], 1), B, [[0.0, 0, 1, 1, 0]]).zeros
    np.testing.assert_allclose(np.sort(zeros.real), [-2.5e-5 / (3 + 2.5e-5), 0, 0, 0], rtol=1e-9, atol=1e-9)
