"""The running kernel gives one answer, to the last bit, however it is built and however the work is cut."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from residua.errors import DataError, ModelError
from residua.linear.systems import recursion
from residua.linear.systems.recursion import Matrices, compiled, ordered_product, run_filter

needs_compiled = pytest.mark.skipif(not compiled(), reason="built without a C compiler")
PATHS = range(recursion._BEST_PATH + 1)


def assert_same_bits(actual: np.ndarray, expected: np.ndarray) -> None:
    """Equal to the last bit, signs of zeros included; a NaN equals a NaN whatever its payload."""
    assert actual.shape == expected.shape
    assert actual.dtype == expected.dtype == np.float64
    np.testing.assert_array_equal(np.isnan(actual), np.isnan(expected))
    kept = ~np.isnan(expected)
    np.testing.assert_array_equal(actual[kept].view(np.int64), expected[kept].view(np.int64))


def random_filter(
    rng: np.random.Generator, n: int, m: int, nr: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    A = rng.normal(size=(n, n))
    if n:
        A *= 0.98 / np.max(np.abs(np.linalg.eigvals(A)))
    return A, rng.normal(size=(n, m)), rng.normal(size=(nr, n)), rng.normal(size=(nr, m))


def by_hand(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, x: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The definition, one rounded operation at a time, in Python floats."""
    r = np.zeros((v.shape[0], v.shape[1], len(C)))
    x_next = np.zeros(x.shape)
    for p in range(len(v)):
        now = x[p].tolist()
        for k in range(v.shape[1]):
            z = v[p, k].tolist() + now
            both = []
            for row in np.vstack([np.hstack([B, A]), np.hstack([D, C])]).tolist():
                total = 0.0
                for gain, value in zip(row, z, strict=True):
                    total = total + gain * value
                both.append(total)
            now = both[: len(A)]
            r[p, k] = both[len(A) :]
        x_next[p] = now
    return x_next, r


sizes = st.tuples(st.integers(0, 19), st.integers(0, 9), st.integers(0, 18), st.integers(0, 4), st.integers(0, 7))


@needs_compiled
@pytest.mark.parametrize("path", PATHS)
@settings(max_examples=150, deadline=None)
@given(sizes=sizes, seed=st.integers(0, 2**32 - 1), special=st.booleans())
def test_compiled_equals_numpy_bitwise(
    path: int, sizes: tuple[int, int, int, int, int], seed: int, special: bool
) -> None:
    n, m, nr, plants, time = sizes
    rng = np.random.default_rng(seed)
    matrices = random_filter(rng, n, m, nr)
    x, v = rng.normal(size=(plants, n)), rng.normal(size=(plants, time, m))
    if special and v.size:
        odd = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 1e308, 5e-324, -2e-308])
        mask = rng.random(v.shape) < 0.1
        v[mask] = rng.choice(odd, size=int(mask.sum()))
        for M in matrices:
            M[rng.random(M.shape) < 0.2] = rng.choice([0.0, -0.0, 1e-300])
    expected = recursion._run_numpy(matrices, x, v)
    actual = recursion._run_compiled(matrices, x, v, path)
    for one, other in zip(actual, expected, strict=True):
        assert_same_bits(one, other)


def bank(rng: np.random.Generator, members: list[tuple[int, int]], m: int) -> Matrices:
    """Return filters of some states and outputs, stacked: zeros of either sign wherever they have nothing in common."""
    n, nr = (sum(sizes) for sizes in zip(*members, strict=True))
    B, D = rng.normal(size=(n, m)), rng.normal(size=(nr, m))
    A, C = (np.where(rng.random(shape) < 0.5, 0.0, -0.0) for shape in ((n, n), (nr, n)))
    at = row = 0
    for states, outputs in members:
        A[at : at + states, at : at + states] = 0.8 * rng.normal(size=(states, states)) / max(1, states) ** 0.5
        C[row : row + outputs, at : at + states] = rng.normal(size=(outputs, states))
        at, row = at + states, row + outputs
    return A, B, C, D


@needs_compiled
@pytest.mark.parametrize("path", PATHS)
@settings(max_examples=100, deadline=None)
@given(
    members=st.lists(st.tuples(st.integers(0, 10), st.integers(0, 5)), min_size=1, max_size=40),
    shape=st.sampled_from(((1, 0), (1, 1), (3, 1), (300, 1), (1, 5), (2, 300), (3, 600))),
    m=st.integers(0, 4),
    marks=st.lists(st.sampled_from((np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, -0.0)), max_size=3),
    cut=st.integers(0, 600),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_bank_has_the_bits_of_all_products(
    path: int,
    members: list[tuple[int, int]],
    shape: tuple[int, int],
    m: int,
    marks: list[float],
    cut: int,
    seed: int,
) -> None:
    """Zeros that are left out change nothing; where a value or a state is not finite, they are taken along."""
    rng = np.random.default_rng(seed)
    matrices = bank(rng, members, m)
    x, v = rng.normal(size=(shape[0], len(matrices[0]))), rng.normal(size=(*shape, m))
    for mark in marks:
        target = v if v.size and rng.random() < 0.7 else x
        if target.size:
            target[tuple(int(rng.integers(size)) for size in target.shape)] = mark
    expected = recursion._run_numpy(matrices, x, v)
    middle, first = recursion._run_compiled(matrices, x, np.ascontiguousarray(v[:, :cut]), path)
    after, second = recursion._run_compiled(matrices, middle, np.ascontiguousarray(v[:, cut:]), path)
    assert_same_bits(after, expected[0])
    assert_same_bits(np.concatenate([first, second], axis=1), expected[1])


@pytest.mark.parametrize("path", [None, *(PATHS if compiled() else ())])
@settings(max_examples=60, deadline=None)
@given(n=st.integers(1, 12), nr=st.integers(1, 9), seed=st.integers(0, 2**32 - 1))
def test_a_filter_at_rest_has_no_denormal_states(path: int | None, n: int, nr: int, seed: int) -> None:
    """After silent samples no state is between zero and 2^-500; the same bits in C, in NumPy and for any cut."""
    rng = np.random.default_rng(seed)
    matrices = random_filter(rng, n, 3, nr)
    v = rng.normal(size=(2, 40, 3)) * 2.0 ** rng.integers(-1060, 0, (2, 40, 1))
    v[rng.random((2, 40)) < 0.5] = 0.0
    v[:, -1] = rng.choice([0.0, -0.0], (2, 3))
    x = rng.normal(size=(2, n)) * 2.0 ** rng.integers(-1074, 0, (2, n))

    def run(x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if path is None:
            return recursion._run_numpy(matrices, x, v)
        return recursion._run_compiled(matrices, x, np.ascontiguousarray(v), path)

    after, r = run(x, v)
    assert not ((np.abs(after) < recursion.SMALLEST) & (after != 0)).any()
    for one, other in zip((after, r), recursion._run_numpy(matrices, x, v), strict=True):
        assert_same_bits(one, other)
    middle, first = run(x, v[:, :17])
    last, second = run(middle, v[:, 17:])
    assert_same_bits(last, after)
    assert_same_bits(np.concatenate([first, second], axis=1), r)


@pytest.mark.parametrize("n", [*range(10), 17])
@pytest.mark.parametrize("nr", [0, 1, 2, 3, 4, 5, 8, 9])
def test_is_the_definition_bitwise(n: int, nr: int) -> None:
    rng = np.random.default_rng(100 * n + nr)
    m = 3
    matrices = random_filter(rng, n, m, nr)
    x, v = rng.normal(size=(2, n)), rng.normal(size=(2, 12, m))
    for one, other in zip(run_filter(*matrices, x, v), by_hand(*matrices, x, v), strict=True):
        assert_same_bits(one, other)


def test_agrees_with_matrix_products() -> None:
    rng = np.random.default_rng(1)
    A, B, C, D = random_filter(rng, 6, 3, 2)
    x, v = rng.normal(size=(1, 6)), rng.normal(size=(1, 200, 3))
    x_next, r = run_filter(A, B, C, D, x, v)
    state = x[0]
    for k in range(200):
        np.testing.assert_allclose(r[0, k], C @ state + D @ v[0, k], rtol=1e-10, atol=1e-10)
        state = A @ state + B @ v[0, k]
    np.testing.assert_allclose(x_next[0], state, rtol=1e-10, atol=1e-10)


@pytest.fixture(params=["compiled", "numpy"])
def implementation(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Run the test once with the compiled kernel and once with NumPy."""
    if request.param == "numpy":
        monkeypatch.setattr(recursion, "_kernel", None)
        monkeypatch.setattr(recursion, "_PASS", 50)  # so that a short run takes several passes
    elif not compiled():
        pytest.skip("built without a C compiler")
    return request.param


@pytest.mark.parametrize("n", [0, 1, 3, 4, 7, 12])
def test_chunks_and_steps_equal_one_run(implementation: str, n: int) -> None:
    rng = np.random.default_rng(n)
    matrices = random_filter(rng, n, 4, 3)
    x, v = rng.normal(size=(2, n)), rng.normal(size=(2, 137, 4))
    x_whole, r_whole = run_filter(*matrices, x, v)
    for cuts in ([0, 137], [0, 1, 2, 50, 50, 136, 137], list(range(138))):
        state, pieces = x, []
        for start, stop in itertools.pairwise(cuts):
            state, r = run_filter(*matrices, state, v[:, start:stop])
            pieces.append(r)
        assert_same_bits(np.concatenate(pieces, axis=1), r_whole)
        assert_same_bits(state, x_whole)


@pytest.mark.parametrize("n", [1, 4, 9])
def test_many_plants_equal_each_alone(implementation: str, n: int) -> None:
    rng = np.random.default_rng(n)
    matrices = random_filter(rng, n, 2, 5)
    x, v = rng.normal(size=(30, n)), rng.normal(size=(30, 20, 2))
    x_all, r_all = run_filter(*matrices, x, v)
    for p in range(30):
        x_one, r_one = run_filter(*matrices, x[p : p + 1], v[p : p + 1])
        assert_same_bits(x_one[0], x_all[p])
        assert_same_bits(r_one[0], r_all[p])


def test_nan_stays_in_its_plant_and_where_it_belongs(implementation: str) -> None:
    A, B = np.diag([0.5, 0.2]), np.eye(2)
    C, D = np.eye(2), np.zeros((2, 2))
    v = np.ones((3, 10, 2))
    v[1, 4, 0] = np.nan
    _, r = run_filter(A, B, C, D, np.zeros((3, 2)), v)
    assert np.isfinite(r[[0, 2]]).all()
    assert np.isfinite(r[1, :4]).all()
    assert np.isnan(r[1, 5:]).all()  # 0 * nan is nan: a lost sample may not pass for a good one


def test_layout_and_type_of_inputs_do_not_matter(implementation: str) -> None:
    rng = np.random.default_rng(5)
    A, B, C, D = random_filter(rng, 4, 3, 2)
    x, v = rng.normal(size=(6, 4)), rng.normal(size=(6, 20, 3))
    expected = run_filter(A, B, C, D, x[::2], v[::2, :, ::-1])
    fortran = [np.asfortranarray(M) for M in (A, B, C, D)]
    wide = np.zeros((3, 40, 3))
    wide[:, ::2] = v[::2, :, ::-1]
    read_only = x[::2].copy()
    read_only.setflags(write=False)
    actual = run_filter(*fortran, read_only, wide[:, ::2].astype(">f8"))
    for one, other in zip(actual, expected, strict=True):
        assert_same_bits(one, other)
    whole = run_filter([[1]], [[2]], [[1]], [[0]], [[3]], [[[1], [1]]])
    assert_same_bits(whole[1], np.array([[[3.0], [5.0]]]))


def test_inputs_are_not_written(implementation: str) -> None:
    rng = np.random.default_rng(6)
    matrices = random_filter(rng, 3, 2, 2)
    x, v = rng.normal(size=(1, 3)), rng.normal(size=(1, 5, 2))
    before = [a.copy() for a in (*matrices, x, v)]
    x_next, _ = run_filter(*matrices, x, v)
    for one, other in zip((*matrices, x, v), before, strict=True):
        assert_same_bits(one, other)
    x_still, r = run_filter(*matrices, x, v[:, :0])
    assert_same_bits(x_still, x)
    assert r.shape == (1, 0, 2)
    assert not np.shares_memory(x_still, x)
    assert not np.shares_memory(x_next, x)


@pytest.mark.parametrize("shape", [(3,), (7, 3), (2, 5, 3), (0, 3), (2, 0, 3)])
@pytest.mark.parametrize("q", [0, 1, 2, 6, 11])
def test_ordered_product(implementation: str, shape: tuple[int, ...], q: int) -> None:
    rng = np.random.default_rng(q)
    X, M = rng.normal(size=shape), rng.normal(size=(3, q))
    product = ordered_product(X, M)
    assert product.shape == (*shape[:-1], q)
    np.testing.assert_allclose(product, X @ M, rtol=1e-12, atol=1e-12)
    expected = np.zeros(product.shape)
    for j in range(3):
        expected = expected + X[..., j, np.newaxis] * M[j]
    assert_same_bits(product, expected)


def test_ordered_product_does_not_depend_on_the_cut(implementation: str) -> None:
    rng = np.random.default_rng(8)
    X, M = rng.normal(size=(300, 13)), rng.normal(size=(13, 7))
    whole = ordered_product(X, M)
    assert_same_bits(np.concatenate([ordered_product(X[:101], M), ordered_product(X[101:], M)]), whole)
    assert_same_bits(np.stack([ordered_product(row, M) for row in X]), whole)
    assert_same_bits(np.column_stack([ordered_product(X, M[:, i : i + 1]) for i in range(7)]), whole)


def test_ordered_product_without_terms_is_zero(implementation: str) -> None:
    assert_same_bits(ordered_product(np.zeros((4, 0)), np.zeros((0, 2))), np.zeros((4, 2)))


ONE = np.ones((1, 1))


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ((np.ones((2, 1)), ONE, ONE, ONE, ONE, ONE[np.newaxis]), ModelError, "do not fit"),
        ((ONE, ONE, ONE, np.ones((1, 2)), ONE, ONE[np.newaxis]), ModelError, "do not fit"),
        ((ONE, ONE[0], ONE, ONE, ONE, ONE[np.newaxis]), ModelError, "dimensions"),
        ((ONE, ONE, ONE, ONE, ONE[0], ONE[np.newaxis]), DataError, "1 states"),
        ((ONE, ONE, ONE, ONE, ONE, ONE), DataError, "plants, time"),
        ((ONE, ONE, ONE, ONE, np.ones((2, 1)), ONE[np.newaxis]), DataError, "plants"),
        ((ONE, ONE, ONE, ONE, ONE, np.ones((1, 4, 2))), DataError, "1 inputs"),
        ((ONE, ONE, ONE, ONE, ONE, 1j * np.ones((1, 4, 1))), DataError, "real"),
    ],
)
def test_misfits_are_refused(arguments: tuple[np.ndarray, ...], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        run_filter(*arguments)


def test_ordered_product_refuses_misfits() -> None:
    with pytest.raises(DataError, match="must be"):
        ordered_product(np.ones((2, 3)), np.ones((2, 3)))


@needs_compiled
def test_kernel_refuses_what_would_overrun_memory() -> None:
    kernel = recursion._kernel
    assert kernel is not None
    v, r = np.ones((1, 3, 1)), np.zeros((1, 3, 1))
    with pytest.raises(ValueError, match="shape"):
        kernel.run(ONE, ONE, ONE, ONE, ONE, v, ONE.copy(), r[:, :2].copy(), 0)
    with pytest.raises(TypeError, match="float64"):
        kernel.run(ONE, ONE, ONE, ONE, ONE, v.astype(np.float32), ONE.copy(), r, 0)
    with pytest.raises(TypeError, match="dimensions"):
        kernel.run(ONE, ONE, ONE, ONE, ONE, v[0], ONE.copy(), r, 0)
    with pytest.raises((ValueError, BufferError)):
        kernel.run(ONE, ONE, ONE, ONE, ONE, np.ones((1, 6, 1))[:, ::2], ONE.copy(), r, 0)
    with pytest.raises(ValueError, match="path"):
        kernel.run(ONE, ONE, ONE, ONE, ONE, v, ONE.copy(), r, 9)
    frozen = r.copy()
    frozen.setflags(write=False)
    with pytest.raises((ValueError, BufferError)):
        kernel.run(ONE, ONE, ONE, ONE, ONE, v, ONE.copy(), frozen, 0)


def test_environment_forces_numpy() -> None:
    code = "import residua.linear.systems.recursion as r; print(r.compiled())"
    environment = {**os.environ, "RESIDUA_NO_COMPILED": "1"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@pytest.mark.parametrize("columns", [0, 1, 3])
@pytest.mark.parametrize("order", [0, 2, 4, 11])
def test_inputs_side_by_side_give_the_bits_of_one_array(columns: int, order: int) -> None:
    rng = np.random.default_rng(order)
    A, B, C, D = (rng.standard_normal(shape) * 0.3 for shape in ((order, order), (order, 3), (5, order), (5, 3)))
    x, data = rng.standard_normal((2, order)), rng.standard_normal((2, 50, 3))
    data[1, 20:30] = 0.0
    v, w = np.ascontiguousarray(data[..., :columns]), np.ascontiguousarray(data[..., columns:])
    expected = run_filter(A, B, C, D, x, data)
    for first, second in ((v, w), (data[..., :columns], data[..., columns:])):
        actual = recursion.run_side_by_side((A, B, C, D), x, first, second)
        for one, other in zip(actual, expected, strict=True):
            assert np.array_equal(one, other)
    if columns == 1 and recursion.compiled():
        with pytest.raises(ValueError, match="shape"):
            recursion.run_side_by_side((A, B, C, D), x, v, v)
