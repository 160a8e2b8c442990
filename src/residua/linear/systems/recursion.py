"""Running a discrete-time filter over data, with the same bits however the work is cut.

The sums are formed in one fixed order, in C and in NumPy alike. That makes a live monitor agree with a
run over the whole recording to the last bit, on every machine with IEEE 754 arithmetic.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import aligned
from residua.errors import DataError, ModelError
from residua.kernels import kernel

_kernel = kernel("residua.linear.systems._recursion")

_BEST_PATH: int = _kernel.best_path() if _kernel is not None else 0
#: A state below this size becomes zero after a sample of nothing but zeros: denormal numbers cost many times a product.
SMALLEST = 2.0**-500
#: Samples per pass of the NumPy fallback: bounds its memory, and does not change a bit of the result.
_PASS = 65536
#: Multiplications per sample below which Python floats beat NumPy calls in the recurrent part.
_SCALAR_WORK = 150

Matrices = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def compiled() -> bool:
    """Tell whether the compiled kernel is in use.

    Returns
    -------
    bool
        False when the package was built without a C compiler, or the environment variable
        ``RESIDUA_NO_COMPILED`` was ``1`` at import. The results are the same bits, only slower.
    """
    return _kernel is not None


def best_path() -> int:
    """Return the number of the fastest path of the compiled kernels that this processor has."""
    return _BEST_PATH


def run_filter(
    A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike, x: ArrayLike, v: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Run a discrete-time filter over the data of one plant or many.

    ``x[k+1] = A x[k] + B v[k]``, ``r[k] = C x[k] + D v[k]``, for each plant on its own.

    Guaranteed: the result is the same to the last bit for any cutting of the time into chunks (``x_next``
    handed on as the next ``x``), any number of plants run together, and the compiled kernel or NumPy.
    Each sum starts at zero, takes the columns of ``v`` in order, then those of ``x``, and rounds every
    product before adding it. NaN and infinity flow as IEEE 754 says; that a value is NaN is kept, the
    payload of the NaN is not. After a sample of nothing but zeros, states below ``2**-500`` in size become zero, so
    that a filter at rest does not slow down among the denormal numbers.

    Assumes nothing of the filter: an unstable one overflows to infinity without a word.

    Parameters
    ----------
    A, B, C, D : array_like
        Matrices of shapes (n, n), (n, m), (nr, n), (nr, m); real. Any of n, m, nr may be 0.
    x : array_like, shape (plants, n)
        State of each plant before the first sample.
    v : array_like, shape (plants, time, m)
        Inputs of the filter; for a residual generator, the controls then the measurements.

    Returns
    -------
    x_next : ndarray, shape (plants, n)
        State after the last sample, as a new array (equal to ``x`` when the time is empty).
    r : ndarray, shape (plants, time, nr)
        Outputs of the filter.

    Raises
    ------
    ModelError
        If the matrices do not fit one another.
    DataError
        If ``x`` or ``v`` does not fit the matrices.

    Examples
    --------
    >>> import numpy as np
    >>> A, B, C, D = [[0.5]], [[1.0]], [[1.0]], [[0.0]]
    >>> v = np.ones((1, 4, 1))
    >>> x, r = run_filter(A, B, C, D, np.zeros((1, 1)), v)
    >>> r[0, :, 0]
    array([0.  , 1.  , 1.5 , 1.75])
    >>> x_half, first = run_filter(A, B, C, D, np.zeros((1, 1)), v[:, :3])
    >>> _, last = run_filter(A, B, C, D, x_half, v[:, 3:])
    >>> bool(last[0, 0, 0] == r[0, 3, 0])
    True
    """
    matrices = (_as_array("A", A), _as_array("B", B), _as_array("C", C), _as_array("D", D))
    state, data = _as_array("x", x), _as_array("v", v)
    if any(M.ndim != 2 for M in matrices):
        raise ModelError(f"A, B, C, D must be matrices, got {[M.ndim for M in matrices]} dimensions")
    shapes = [M.shape for M in matrices]
    n, m, nr = *shapes[1], len(matrices[2])
    if shapes != [(n, n), (n, m), (nr, n), (nr, m)]:
        raise ModelError(
            "the matrices do not fit: A {}, B {}, C {}, D {}; expected (n, n), (n, m), (nr, n), (nr, m)".format(*shapes)
        )
    if state.ndim != 2 or data.ndim != 3 or len(state) != len(data) or state.shape[1] != n or data.shape[2] != m:
        raise DataError(
            f"x {state.shape} and v {data.shape} do not fit a filter of {n} states and {m} inputs; "
            f"expected x (plants, {n}) and v (plants, time, {m})"
        )
    return run_checked(matrices, state, data)


def run_checked(matrices: Matrices, x: NDArray, v: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Run a filter over arrays that are known to fit, C-contiguous and of floats: the same bits, sooner."""
    return _run_numpy(matrices, x, v) if _kernel is None else _run_compiled(matrices, x, v, _BEST_PATH)


def run_side_by_side(
    matrices: Matrices, x: NDArray, v: NDArray, w: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Run a filter whose inputs are the columns of ``v`` and then those of ``w``, both (plants, time, columns).

    The bits are those of :func:`run_filter` on ``[v, w]``, which is not made where both lie in order.
    """
    if _kernel is None or not (v.flags.c_contiguous and w.flags.c_contiguous):
        return run_checked(matrices, x, np.ascontiguousarray(np.concatenate([v, w], axis=2)))
    return _run_compiled(matrices, x, v, _BEST_PATH, w)


def ordered_product(X: ArrayLike, M: ArrayLike) -> NDArray[np.float64]:
    """Multiply as ``X @ M``, every sum in the same order.

    Guaranteed: the rows of the result are the same to the last bit however ``X`` is cut along its leading
    axes, compiled or not; a call to BLAS does not give that. Each sum starts at zero and takes the terms
    in order.

    Parameters
    ----------
    X : array_like, shape (..., k)
        Data, real; at least one axis.
    M : array_like, shape (k, q)
        Matrix, real.

    Returns
    -------
    ndarray, shape (..., q)

    Raises
    ------
    DataError
        If the shapes do not fit or an entry is not real.

    Examples
    --------
    >>> import numpy as np
    >>> ordered_product(np.ones((2, 3)), [[1.0, 0.0], [2.0, 0.0], [4.0, 1.0]])
    array([[7., 1.],
           [7., 1.]])
    """
    data, matrix = _as_array("X", X), _as_array("M", M)
    if data.ndim < 1 or matrix.ndim != 2 or data.shape[-1] != matrix.shape[0]:
        raise DataError(f"X {data.shape} @ M {matrix.shape}: X must be (..., k) and M (k, q)")
    return product_checked(data, matrix)


def product_checked(data: NDArray, matrix: NDArray) -> NDArray[np.float64]:
    """Multiply as :func:`ordered_product`, of arrays of floats that are known to fit: the same bits, sooner."""
    k, q = matrix.shape
    rows = math.prod(data.shape[:-1])
    nothing = (np.zeros((0, 0)), np.zeros((0, k)), np.zeros((q, 0)), np.ascontiguousarray(matrix.T))
    flat = np.ascontiguousarray(data).reshape(1, rows, k)
    _, product = run_checked(nothing, np.zeros((1, 0)), flat)
    return product.reshape(*data.shape[:-1], q)


def _as_array(name: str, value: ArrayLike) -> NDArray[np.float64]:
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        raise DataError(f"{name} must be real numbers, got an array of {array.dtype}")
    return aligned(array.astype(np.float64, order="C", copy=False))


def _run_compiled(
    matrices: Matrices, x: NDArray, v: NDArray, path: int, w: NDArray | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    assert _kernel is not None
    x_next = np.empty(x.shape)
    r = np.empty((v.shape[0], v.shape[1], matrices[2].shape[0]))
    _kernel.run(*matrices, np.ascontiguousarray(x), v, x_next, r, path, *(() if w is None else (w,)))
    return x_next, r


def _accumulate(total: NDArray, data: NDArray, matrix: NDArray) -> None:
    """Add ``data @ matrix.T`` to ``total``, one column of the matrix after the other."""
    for j in range(matrix.shape[1]):
        total += data[..., j, np.newaxis] * matrix[:, j]


def _run_numpy(matrices: Matrices, x: NDArray, v: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    A, B, C, D = matrices
    plants, time, _ = v.shape
    n, nr = len(A), len(C)
    r = np.zeros((plants, time, nr))
    state = x.copy()
    step = max(1, _PASS // max(1, plants))
    with np.errstate(all="ignore"):
        for start in range(0, time, step):
            block = v[:, start : start + step]
            out = r[:, start : start + step]
            forced = np.zeros((plants, block.shape[1], n))
            _accumulate(forced, block, B)
            states, state = _recur(A, state, forced, np.asarray(~block.any(axis=2)))
            _accumulate(out, block, D)
            _accumulate(out, states, C)
    return state, r


def _recur(A: NDArray, x: NDArray, forced: NDArray, silent: NDArray[np.bool_]) -> tuple[NDArray, NDArray]:
    """Return the state at every sample, and after the last.

    ``forced`` is ``B v`` at every sample, and ``silent`` says where ``v`` is nothing but zeros.
    """
    plants, time, n = forced.shape
    if plants * n * n > _SCALAR_WORK:
        states = np.empty_like(forced)
        for k in range(time):
            states[:, k] = x
            total = forced[:, k].copy()
            _accumulate(total, x, A)
            total[silent[:, k, None] & (np.abs(total) < SMALLEST) & (total != 0)] = 0.0
            x = total
        return states, x
    # Python floats are the same IEEE doubles, and far quicker than calls on arrays of a few entries.
    rows = A.tolist()
    ends, histories = [], []
    for start, inputs, rests in zip(x.tolist(), forced.tolist(), silent.tolist(), strict=True):
        now, history = start, []
        for push, rest in zip(inputs, rests, strict=True):
            history.append(now)
            following = []
            for total, row in zip(push, rows, strict=True):
                for gain, value in zip(row, now, strict=True):
                    total += gain * value
                following.append(0.0 if rest and total and -SMALLEST < total < SMALLEST else total)
            now = following
        ends.append(now)
        histories.append(history)
    return np.array(histories).reshape(forced.shape), np.array(ends).reshape(x.shape)
