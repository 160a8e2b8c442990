"""Invariant zeros and normal rank of any linear system: non-square, descriptor, with hidden modes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.errors import AccuracyError
from residua.linear.poles.deflation import Matrices, deflated
from residua.linear.poles.matrix_poles import is_rounding_of_zero
from residua.linear.poles.settled_zeros import even_pencil_at, may_have_moved, settled
from residua.linear.poles.zero_structure import rounding_of, without_zero_eigenvalues
from residua.linear.subspaces.observability import staircase
from residua.linear.subspaces.parts import part_numbers, triangular_parts
from residua.linear.subspaces.rank import DEFAULT_RTOL, RankDecision, decide_rank, spectral_norm
from residua.linear.systems.balancing import balance_system, descriptor_units, power_of_two, without_rounding
from residua.linear.systems.units import bordered, system_rate
from residua.tolerances import RANK, ROUNDING

#: What rounding leaves of the next zeros, as a multiple of what it left of those that were dropped.
_BEYOND_DROPPED = 10.0
#: Where bases are known to no better than this, zeros are counted in rational numbers, too.
_TURNED = ROUNDING
#: Products of entries so far below all can be less than rounding, and are couplings all the same.
_FAR_APART = 2.0**-20
#: With a rate of less, inputs have units by which what is divided by it stays far from the largest numbers.
_SLOWEST = 2.0**-600


@dataclass(frozen=True, eq=False)
class InvariantZeros:
    """The finite invariant zeros of a system and the rank of its transfer matrix.

    Attributes
    ----------
    zeros : ndarray of complex
        With multiplicity, sorted by real part.
    normal_rank : int
        Rank of the transfer matrix at almost every ``s``: that of the pencil less ``n``.
    decisions : tuple of RankDecision
        Every rank decision on the way, in balanced units.
    """

    zeros: NDArray[np.complex128]
    normal_rank: int
    decisions: tuple[RankDecision, ...]


def _checked(
    A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike | None, E: ArrayLike | None
) -> tuple[Matrices, NDArray[np.float64] | None]:
    A = arrays.matrix(A, "A", (None, None))
    n = A.shape[0]
    A = arrays.matrix(A, "A", (n, n))
    B = arrays.matrix(B, "B", (n, None))
    C = arrays.matrix(C, "C", (None, n))
    shape = (C.shape[0], B.shape[1])
    D = np.zeros(shape) if D is None else arrays.matrix(D, "D", shape)
    if E is None:
        return (A, B, C, D), None
    E = arrays.matrix(E, "E", (n, n))
    return (A, B, C, D), None if np.array_equal(E, np.eye(n)) else E


def _equilibrated(M: Matrices, E: NDArray[np.float64]) -> tuple[Matrices, NDArray[np.float64], float]:
    """Scale rows and columns of a descriptor pencil by powers of two; return the unit of ``s`` too."""
    A, B, C, D = M
    u = descriptor_units(A, E, B, C, D)
    r, q, c, v = u.equations[:, None], u.outputs[:, None], u.states, u.inputs
    return (r * A * c, r * B * v, q * C * c, q * D * v), u.unit * r * E * c, u.unit


def _standard_form(
    M: Matrices, E: NDArray[np.float64] | None, rtol: float, decisions: list[RankDecision]
) -> tuple[Matrices, float, int]:
    """Return a system with the identity for ``E``, the unit of its ``s``, and how many states were algebraic."""
    if E is None:
        return M, 1.0, 0
    even, E, unit = _equilibrated(M, E)
    standard = _standard(even, E, rtol, decisions)
    return standard, unit, len(M[0]) - len(standard[0])


def _standard(M: Matrices, E: NDArray[np.float64], rtol: float, decisions: list[RankDecision]) -> Matrices:
    """Turn the algebraic part of a descriptor system into inputs and outputs, and ``E`` into the identity."""
    A, B, C, D = M
    U, s, V = _singular_vectors(E)
    tolerance = rtol * float(s.max(initial=0.0))
    k = int(np.count_nonzero(s > tolerance))
    decisions.append(RankDecision(k, s, tolerance))
    # Both sides share the division, so that an ill-conditioned E costs only the root of its condition.
    root = np.sqrt(s[:k])
    A, B, C = without_rounding(U.T, A, V), without_rounding(U.T, B), without_rounding(C, V)
    A11 = A[:k, :k] / root[:, None] / root
    B1 = np.hstack([A[:k, k:], B[:k]]) / root[:, None]
    C1 = np.vstack([A[k:, :k], C[:, :k]]) / root
    return A11, B1, C1, np.block([[A[k:, k:], B[k:]], [C[:, k:], D]])


def _singular_vectors(E: NDArray[np.float64]) -> tuple[NDArray, NDArray, NDArray]:
    """Return the singular vectors and values of a square matrix, largest first, those of each part by themselves.

    Rounding that mixes parts would couple states that nothing couples, and balancing would make it a coupling.
    """
    of_rows, of_columns = part_numbers(E != 0)
    n = len(E)
    U, V, values = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    first, last_row, last_column = 0, n, n  # pairs are filled in from the left, what is left on one side from the right
    for part in range(int(max(of_rows.max(initial=-1), of_columns.max(initial=-1))) + 1):
        rows, columns = np.flatnonzero(of_rows == part), np.flatnonzero(of_columns == part)
        left, s, right = np.linalg.svd(E[np.ix_(rows, columns)])
        pairs = len(s)
        over, beyond = len(rows) - pairs, len(columns) - pairs
        U[rows, first : first + pairs] = left[:, :pairs]
        V[columns, first : first + pairs] = right[:pairs].T
        U[rows, last_row - over : last_row] = left[:, pairs:]
        V[columns, last_column - beyond : last_column] = right[pairs:].T
        values[first : first + pairs] = s
        first, last_row, last_column = first + pairs, last_row - over, last_column - beyond
    order = np.argsort(-values, kind="stable")
    return U[:, order], values[order], V[:, order]


def _balanced(M: Matrices) -> tuple[Matrices, float]:
    """Balance a standard system and choose the unit of ``s``, which outputs take too: all blocks stay comparable.

    In the unit of time in which its rates are near one, so that it comes out the same in whatever unit it was written.
    """
    A, B, C, D = M
    rate = system_rate(A, B, C, D) or 1.0
    if rate < _SLOWEST:
        inputs = float(power_of_two(np.sqrt(rate)))
        B, D = B * inputs, D * inputs
    b = balance_system(A / rate, B / rate, C, D)
    size = spectral_norm(b.A)
    unit = float(power_of_two(np.array(size))) if size else 1.0
    return (b.A / unit, b.B / unit, b.C / unit, b.D / unit), rate * unit


def invariant_zeros(
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: ArrayLike | None = None,
    E: ArrayLike | None = None,
    *,
    rtol: float = DEFAULT_RTOL,
) -> InvariantZeros:
    r"""Find every finite ``s`` at which the system pencil loses rank.

    .. math:: P(s) = \begin{bmatrix} sE - A & -B \\ C & D \end{bmatrix}

    of any shape, square or not. Decoupling zeros that lie in the pencil are among them. The pencil is compressed by
    orthogonal steps to a square regular one; nothing is squared down at random, which would add zeros that are none.

    Parameters
    ----------
    A : array_like, shape (n, n)
    B : array_like, shape (n, m)
    C : array_like, shape (p, n)
    D : array_like, shape (p, m), optional
    E : array_like, shape (n, n), optional
        May be singular. Identity when omitted.
    rtol : float
        Relative to the norm of the balanced pencil.

    Returns
    -------
    InvariantZeros

    Raises
    ------
    ModelError
        If a matrix is malformed.
    AccuracyError
        If the compressed pencil is not square or its zeros are not finite.

    References
    ----------
    Emami-Naeini and Van Dooren, Computation of zeros of linear multivariable systems, Automatica 18 (1982) 415-430.

    Examples
    --------
    >>> invariant_zeros([[0, 1], [-2, -3]], [[0], [1]], [[4, 1]]).zeros.real.round(12)
    array([-4.])
    """
    decisions: list[RankDecision] = []
    M, unit, algebraic = _standard_form(*_checked(A, B, C, D, E), rtol, decisions)
    zeros, rank = _zeros_by_parts(M, rtol, decisions)
    return InvariantZeros(unit * zeros[np.lexsort((zeros.imag, zeros.real))], rank - algebraic, tuple(decisions))


def _zeros_by_parts(M: Matrices, rtol: float, decisions: list[RankDecision]) -> tuple[NDArray[np.complex128], int]:
    """Return the zeros of a standard system and the rank of its transfer matrix, from the parts of its pencil.

    Where the diagonal blocks of a block triangular pencil have full rank, its zeros are theirs: what is hidden from all
    outputs has its modes exactly, whatever else the system is made of, and each part has units of its own.
    """
    n = len(M[0])
    if n > max(M[3].shape) and all(X.all() for X in M[:3]):  # there are no parts, as is quickly seen
        return _zeros_of_whole(M, rtol, decisions)
    whole = bordered(*M)
    parts = triangular_parts((whole != 0) | _diagonal(whole.shape, n))
    found: list[NDArray[np.complex128]] = [np.zeros(0, dtype=complex)]
    made: list[RankDecision] = []
    for rows, columns in parts if len(parts) > 1 else []:
        own, rank = _zeros_of_part(whole, n, rows, columns, rtol, made)
        if rank < min(len(rows), len(columns)):  # entries cancel
            break
        found.append(own)
    else:
        if len(parts) > 1:
            decisions += made
            return np.concatenate(found), sum(min(len(rows), len(columns)) for rows, columns in parts) - n
    return _zeros_of_whole(M, rtol, decisions)


def zeros_apart(
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: ArrayLike | None = None,
    E: ArrayLike | None = None,
    *,
    rtol: float = DEFAULT_RTOL,
) -> tuple[NDArray[np.complex128], NDArray[np.float64]] | None:
    """Return the zeros of a system and what rounding may have done to each, if all are poles of parts of its pencil.

    Parameters are those of `invariant_zeros`. The parts are the diagonal blocks of the block triangular pencil: states
    that nothing but one another moves, as far as the outputs tell. Their poles are known to their own rounding,
    whatever the rest of the system is made of.

    Returns
    -------
    zeros : ndarray of complex
    uncertainty : ndarray
        Nothing instead of both where other parts have zeros, too, or entries cancel.
    """
    decisions: list[RankDecision] = []
    M, unit, _ = _standard_form(*_checked(A, B, C, D, E), rtol, decisions)
    n, whole = len(M[0]), bordered(*M)
    found: list[NDArray[np.complex128]] = [np.zeros(0, dtype=complex)]
    moved: list[NDArray[np.float64]] = [np.zeros(0)]
    for rows, columns in triangular_parts((whole != 0) | _diagonal(whole.shape, n)):
        if np.array_equal(np.sort(rows), np.sort(columns)) and rows.max(initial=-1) < n:
            block = whole[np.ix_(rows, rows)]
            modes, uncertainty = staircase(block, np.zeros((0, len(rows))), rtol=rtol).hidden_modes
            found.append(modes)
            moved.append(uncertainty)
            continue
        own, rank = _zeros_of_part(whole, n, rows, columns, rtol, decisions)
        if own.size or rank < min(len(rows), len(columns)):
            return None
    zeros, uncertainty = np.concatenate(found), np.concatenate(moved)
    return np.asarray(unit * zeros, dtype=np.complex128), unit * uncertainty


def _diagonal(shape: tuple[int, int], n: int) -> NDArray[np.bool_]:
    """Return where the pencil of a standard system has ``s``."""
    out = np.zeros(shape, dtype=bool)
    out[range(n), range(n)] = True
    return out


def _zeros_of_part(
    whole: NDArray[np.float64],
    n: int,
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    rtol: float,
    decisions: list[RankDecision],
) -> tuple[NDArray[np.complex128], int]:
    """Return the zeros and the rank of some rows and columns of the pencil of a standard system with ``n`` states.

    They are a system, too: a state is one whose equation and whose column are both among them.
    """
    states = np.intersect1d(rows[rows < n], columns[columns < n])
    if not len(rows) or not len(columns):
        return np.zeros(0, dtype=complex), 0
    if len(rows) == len(columns) == 1:
        return whole[states, states].astype(complex), 1
    inputs, outputs = np.setdiff1d(columns, states), np.setdiff1d(rows, states)
    M = tuple(whole[np.ix_(i, j)] for i in (states, outputs) for j in (states, inputs))
    zeros, rank = _zeros_of_whole((M[0], M[1], M[2], M[3]), rtol, decisions)
    return zeros, len(states) + rank


def _zeros_of_whole(M: Matrices, rtol: float, decisions: list[RankDecision]) -> tuple[NDArray[np.complex128], int]:
    """Return the zeros of a standard system and the rank of its transfer matrix."""
    M, unit = _balanced(M)
    whole = bordered(*M)
    scale = spectral_norm(whole) if whole.size else 1.0
    left, decided = deflated(M, rtol, scale)
    decisions += decided.decisions
    # What was dropped tells how much rounding there is, where couplings are weak more than of the steps themselves.
    dropped = max((decision.largest_dropped for decision in decided.decisions), default=0.0)
    rounding = max(rounding_of(len(whole)) * scale, _BEYOND_DROPPED * dropped)
    square = left[3].shape[0] == left[3].shape[1]
    found = left[3].shape[0], (_finite_zeros(left, rounding) if square else None)
    if rtol <= RANK:
        if decided.in_doubt or may_have_moved(found[1], len(M[0]), scale):
            found = settled(M, found)
        elif found[1] is not None and found[1].size and (decided.turned > _TURNED or _far_apart(whole, scale)):
            found = settled(M, found, unless_alike=True)
    rank, zeros = found
    if zeros is None:
        raise AccuracyError(
            f"the compressed pencil is not square (D is {left[3].shape[0]} x {left[3].shape[1]}): a rank decision "
            f"with rtol={rtol:.3g} was not clear; see pencil_rank_at, or choose another rtol"
        )
    if not np.all(np.isfinite(zeros)):
        raise AccuracyError("a zero of the compressed pencil came out infinite: a rank decision was not clear")
    return unit * zeros, rank


def _far_apart(whole: NDArray[np.float64], scale: float) -> bool:
    """Tell whether an entry that is not zero is far below the norm of all."""
    return float(np.min(np.abs(whole), where=whole != 0, initial=np.inf)) < _FAR_APART * scale


def _finite_zeros(M: Matrices, rounding: float) -> NDArray[np.complex128]:
    """Return the zeros of a square system with invertible ``D``, without inverting it, known to ``rounding``."""
    A, B, C, D = M
    k, r = A.shape[0], D.shape[0]
    if not k:
        return np.zeros(0, complex)
    E = None
    if r:
        W = np.linalg.qr(np.hstack([C, D]).T, mode="complete")[0][:, r:]  # what the outputs do not see
        A, E = np.hstack([A, B]) @ W, W[:k]
    scale = rounding / rounding_of(k)
    A, E, count, regular = without_zero_eigenvalues(A, E, scale)
    found = [np.zeros(count, dtype=complex), _eigenvalues(A, E, scale, regular)]
    return np.concatenate(found)


def _eigenvalues(
    A: NDArray[np.float64], E: NDArray[np.float64] | None, scale: float, regular: bool
) -> NDArray[np.complex128]:
    """Return the eigenvalues of a pencil; where it may not be regular, those that may be rounding of zero as zero."""
    if regular:
        return np.asarray(scipy.linalg.eigvals(A, E), dtype=complex)
    zeros, left, right = scipy.linalg.eig(A, E, left=True, right=True)
    overlap = np.abs(np.sum(left.conj() * (right if E is None else E @ right), axis=0))
    overlap /= np.linalg.norm(left, axis=0) * np.linalg.norm(right, axis=0)
    return np.where(is_rounding_of_zero(zeros, overlap, scale), 0.0, zeros).astype(complex)


def normal_rank(
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: ArrayLike | None = None,
    E: ArrayLike | None = None,
    *,
    rtol: float = DEFAULT_RTOL,
) -> int:
    """Return the rank of the transfer matrix at almost every ``s``.

    Parameters are those of `invariant_zeros`.

    Examples
    --------
    >>> normal_rank([[-1.0]], [[1.0, 2.0]], [[1.0], [1.0]])
    1
    """
    return invariant_zeros(A, B, C, D, E, rtol=rtol).normal_rank


def pencil_rank_at(
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: ArrayLike | None = None,
    E: ArrayLike | None = None,
    s: complex = 0.0,
    *,
    rtol: float = DEFAULT_RTOL,
) -> RankDecision:
    """Decide the rank of the system pencil at one ``s``, in units of its rows and columns that even it out.

    Parameters
    ----------
    A, B, C, D, E : array_like
        See `invariant_zeros`.
    s : complex
        Finite.
    rtol : float
        Relative to the largest singular value of the evened pencil at ``s``.

    Returns
    -------
    RankDecision
        Full column rank is ``n + m``, full row rank ``n + p``.

    Examples
    --------
    >>> print(pencil_rank_at([[0, 1], [-2, -3]], [[0], [1]], [[4, 1]], s=-4).rank)
    2
    """
    (A, B, C, D), descriptor = _checked(A, B, C, D, E)
    dynamic = s * (np.eye(len(A)) if descriptor is None else descriptor)
    return decide_rank(even_pencil_at((A, B, C, D), dynamic)[0], rtol=rtol)
