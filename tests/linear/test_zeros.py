"""Invariant zeros: planted ones are found, SLICOT's are reproduced, every one makes the pencil lose rank."""

from __future__ import annotations

import json

import numpy as np
import pytest
import scipy.io
import scipy.linalg

from residua.linear.poles.spectrum import match_poles
from residua.linear.poles.zeros import invariant_zeros, normal_rank, pencil_rank_at


def slicot_zeros(A, B, C, D):
    slycot = pytest.importorskip("slycot")
    n, m, p = A.shape[0], B.shape[1], C.shape[0]
    nu, rank, *_, Af, Bf = slycot.ab08nd(n, m, p, A, B, C, D, equil="S", tol=1e-10, ldwork=20 * (n + m + p + 10) ** 2)
    return (scipy.linalg.eigvals(Af[:nu, :nu], Bf[:nu, :nu]) if nu else np.zeros(0, complex)), rank


def assert_same(found, wanted, tolerance):
    assert found.size == wanted.size
    if wanted.size:
        error = np.abs(found[match_poles(wanted, found)] - wanted)
        assert np.all(error <= tolerance * np.maximum(np.abs(wanted), 1e-3 * np.abs(wanted).max()))


def generated(seed):
    rng = np.random.default_rng(seed)
    n, m, p = (int(rng.integers(1, top)) for top in (16, 5, 5))
    A, B, C = rng.normal(size=(n, n)), rng.normal(size=(n, m)), rng.normal(size=(p, n))
    D = rng.normal(size=(p, m)) * (rng.random() < 0.3)
    if seed % 3 == 1:
        k = int(rng.integers(0, n))
        A[:k, k:] = 0
        C[:, k:] = 0
        T = np.linalg.qr(rng.normal(size=(n, n)))[0]
        A, B, C = T @ A @ T.T, T @ B, C @ T.T
    if seed % 3 == 2:
        D = rng.normal(size=(p, 1)) @ rng.normal(size=(1, m))
        B[:, :1] = A @ B[:, -1:]
    return rng, A, B, C, D


@pytest.mark.parametrize("seed", range(200))
def test_agrees_with_slicot_on_generated_systems_in_any_units(seed):
    rng, A, B, C, D = generated(seed)
    wanted, rank = slicot_zeros(A, B, C, D)
    s, u, y = (10.0 ** rng.uniform(-4, 4, k) for k in (A.shape[0], B.shape[1], C.shape[0]))
    scaled = (A * s[:, None] / s, B * s[:, None] * u, y[:, None] * C / s, y[:, None] * D * u)
    for system in ((A, B, C, D), scaled):
        found = invariant_zeros(*system)
        assert found.normal_rank == rank
        assert_same(found.zeros, wanted, 1e-5)


@pytest.mark.parametrize("seed", range(30))
def test_planted_zeros_of_non_square_systems(seed):
    """Zeros of a square system stay when outputs (or inputs) are combinations of its own."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(2, 10)), 2
    wanted = rng.normal(size=n)
    # With D = I the zeros are the eigenvalues of A - B C.
    B, C = rng.normal(size=(n, m)), rng.normal(size=(m, n))
    V = np.linalg.qr(rng.normal(size=(n, n)))[0]
    A = V @ np.diag(wanted) @ V.T + B @ C
    W = rng.normal(size=(4, m))
    tall = invariant_zeros(A, B, W @ C, W)
    wide = invariant_zeros(A, B @ W.T, C, W.T)
    for found in (tall, wide):
        assert found.normal_rank == m
        assert_same(found.zeros, wanted.astype(complex), 1e-6)


def test_generic_tall_system_has_no_zeros_though_its_square_parts_have():
    rng = np.random.default_rng(0)
    A, B, C = rng.normal(size=(6, 6)), rng.normal(size=(6, 1)), rng.normal(size=(2, 6))
    assert invariant_zeros(A, B, C).zeros.size == 0
    assert invariant_zeros(A, B, C[:1]).zeros.size == 5


@pytest.mark.parametrize("seed", range(30))
def test_descriptor_form_has_the_zeros_of_the_explicit_system(seed):
    """An algebraic state and an invertible ``E`` change nothing."""
    rng, A, B, C, D = generated(seed)
    n, m = A.shape[0], B.shape[1]
    wanted = invariant_zeros(A, B, C, D)
    k = 2
    E0 = scipy.linalg.block_diag(np.eye(n), np.zeros((k, k)))
    A0 = np.block([[A, np.zeros((n, k))], [rng.normal(size=(k, n)), np.eye(k)]])
    B0 = np.vstack([B, rng.normal(size=(k, m))])
    C0 = np.hstack([C, np.zeros((C.shape[0], k))])
    L, R = rng.normal(size=(n + k, n + k)), rng.normal(size=(n + k, n + k))
    found = invariant_zeros(L @ A0 @ R, L @ B0, C0 @ R, D, L @ E0 @ R)
    assert found.normal_rank == wanted.normal_rank
    assert_same(found.zeros, wanted.zeros, 1e-4)


def test_slicot_benchmarks(shared_data):
    folder = shared_data / "slicot_benchmarks"
    checked = 0
    for entry in json.loads((folder / "index.json").read_text()):
        if entry["n"] > 60:
            continue
        data = scipy.io.loadmat(folder / f"{entry['name']}.mat")
        A, B, C, D, E = (np.atleast_2d(data[key]).astype(float) for key in "ABCDE")
        found = invariant_zeros(A, B, C, D, E)
        generic = pencil_rank_at(A, B, C, D, E, s=0.31 + 0.17j).rank
        assert found.normal_rank == generic - A.shape[0], entry["name"]
        # Backward error is what counts: at a zero of a benchmark the pencil must be singular to rounding.
        for zero in found.zeros:
            assert pencil_rank_at(A, B, C, D, E, s=zero, rtol=1e-9).rank < generic, entry["name"]
        if entry["name"] != "BD01_1_06":  # there SLICOT misses five of six hidden modes of the data
            wanted, _ = slicot_zeros(np.linalg.solve(E, A), np.linalg.solve(E, B), C, D)
            assert_same(found.zeros, wanted, 1e-6)
        checked += 1
    assert checked == 33


def test_j100_engine_has_its_unobservable_modes_as_zeros(shared_data):
    data = scipy.io.loadmat(shared_data / "slicot_benchmarks" / "BD01_1_06.mat")
    zeros = invariant_zeros(data["A"], data["B"], data["C"]).zeros
    np.testing.assert_allclose(zeros, [-33.3, -20, -20, -20, -1.67759615, -0.18240385], rtol=1e-7)


def test_rank_of_transfer_matrix():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(5, 5))
    B, C = rng.normal(size=(5, 1)) @ rng.normal(size=(1, 3)), rng.normal(size=(4, 5))
    assert normal_rank(A, B, C) == 1
    assert normal_rank(A, 0 * B, C) == 0
    assert normal_rank(A, B, C, np.eye(4, 3)) == 3


def test_empty_and_static_systems():
    assert invariant_zeros(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((3, 0)), np.ones((3, 2))).normal_rank == 1
    assert invariant_zeros([[-1.0]], np.zeros((1, 0)), np.zeros((0, 1))).zeros == pytest.approx([-1])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [1e-100, 1e-200])
def test_entries_near_the_smallest_numbers_are_rates_like_any(size):
    found = invariant_zeros([[size, size], [size, -size]], [[1], [1]], [[1, 1]])
    assert found.normal_rank == 1
    assert not found.zeros.imag.any()
    np.testing.assert_allclose(found.zeros.real / size, [-1], rtol=1e-9)
