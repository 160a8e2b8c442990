"""Responses of residuals to faults: the marks of a structure, the directions of faults, and steady responses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.design.core.balanced_filter import BalancedFilter, Resolvent, extended_sum
from residua.design.core.internal_form import frequency_grid
from residua.linear import StateSpace
from residua.linear.systems.scaling import power_near
from residua.tolerances import DESIGN_ROUNDING, LEAKAGE, RESIDUE, RESPONSE_ROUNDING, TINY, above_rounding

Matrix = NDArray[np.float64]
#: Of the largest terms of a row and of a column, wherever they stand: they leave rounding, and gains known to it only.
_ELSEWHERE = 1e-2
#: Frequencies at which a response is this far below its largest say nothing about its direction.
_FAINT = 1e-7
#: Faint directions of a response are there when the gap behind them is so much wider than that before them ...
_WIDER = 100.0
#: ... and they carry more than this fraction of it.
_FADED = 1e-9
#: Of the terms of a response: answers that are smaller are no unit of their residual.
_LEAST_ANSWER = 1e-3


@dataclass(frozen=True, eq=False)
class FaultResponses:
    """The responses of a residual to faults, in balanced units, with the terms that they are the sum of.

    Attributes
    ----------
    form : tuple of ndarray
        ``A``, ``B``, ``C``, ``D`` from faults to residuals.
    values : ndarray of complex, shape (k, residuals, faults)
        Exactly zero where a fault does not reach a residual.
    sizes : ndarray, shape (k, residuals, faults)
        What each is made of.
    residuals : ndarray, shape (residuals,)
        The factors that bring the residuals to these units.
    """

    form: tuple[Matrix, Matrix, Matrix, Matrix]
    values: NDArray[np.complex128]
    sizes: Matrix
    residuals: Matrix

    @property
    def reached(self) -> NDArray[np.bool_]:
        """Residuals that each fault reaches, shape (residuals, faults)."""
        return np.any(self.values != 0, axis=0)


def responses_of_filter(f: BalancedFilter, points: NDArray[np.complex128] | None = None) -> FaultResponses:
    r"""Return the responses to the faults of its plant of a filter with a state map.

    The error :math:`e = T E x - \xi` obeys :math:`\dot e = F e + (T B_f - G_y D_f) f` and the residual is
    :math:`-L e + (J_y D_f + V B_f) f`. A fault reaches a residual when the response is more than rounding of its terms
    at some frequency: of those in the internal form, and of those of the filter driven by the plant,
    :math:`\sum_k |Q_{ik}| |P_{kj}|`. The largest entries of row and column count as well, wherever they stand: an entry
    that should be zero is rounding of those.
    """
    points = f.points if points is None else points
    Bf, Df, _ = f.entering(f.plant.Bf, f.plant.Df)
    B = _product((f.T, Bf), (-f.Gy, Df))
    D = _product((f.Jy, Df), (f.V, Bf))
    x, Q = f.of_filter(B, points), f.read(points)
    P = np.abs(f.C @ f.of_plant(Bf, points) + Df)
    L = above_rounding(f.L, np.abs(f.L).max(axis=1, keepdims=True, initial=0.0))
    driven = Q @ P + _ELSEWHERE * Q.max(axis=2, initial=0.0)[:, :, None] * P.max(axis=1, initial=0.0)[:, None, :]
    values, terms = D - L @ x, np.abs(D) + np.abs(L) @ np.abs(x) + driven
    # far above all rates a response falls by powers of frequency, and what rounding leaves of another by fewer
    level = _LEAST_ANSWER * np.median(terms, axis=0)
    reached = np.any(np.abs(values) > DESIGN_ROUNDING * np.maximum(terms, level), axis=0)
    # nor is what states that cancel leave of their own rounding an answer
    small = np.abs(values).max(axis=(0, 1), initial=0.0) < RESPONSE_ROUNDING * np.abs(x).max(axis=(0, 1), initial=0.0)
    if (doubtful := reached.any(axis=0) & small).any():
        sizes, gains = np.abs(x[..., doubtful]), np.abs(Resolvent.of(f.F.T, None)(f.L.T, points)).transpose(0, 2, 1)
        made_of = np.abs(f.F) @ sizes + np.abs(points)[:, None, None] * sizes + np.abs(B[:, doubtful])
        reached[:, doubtful] &= np.any(np.abs(values[..., doubtful]) > RESIDUE * (gains @ made_of), axis=0)
    return FaultResponses((f.F, B, -L, D), np.where(reached, values, 0.0), driven, f.heights)


def responses_of_form(form: StateSpace, faults: int) -> FaultResponses:
    """Return the responses to the first inputs of an internal form, the faults."""
    form = form.select(inputs=range(faults))
    (A, B, C), w = with_even_states(form), frequency_grid(form)
    points = np.asarray(np.exp(1j * w * form.dt) if form.is_discrete else 1j * w, dtype=np.complex128)
    x = Resolvent.of(A, None)(B, points)
    values, terms = C @ x + form.D, np.abs(C) @ np.abs(x) + np.abs(form.D)
    reached = np.any(np.abs(values) > DESIGN_ROUNDING * terms, axis=0)
    heights = 1 / power_near(terms.max(axis=(0, 2), initial=0.0))
    Y = heights[:, None]
    values, terms = np.where(reached, Y * values, complex(0.0)), Y * terms
    return FaultResponses((A, B, Y * C, Y * form.D), values, terms, heights)


def _product(*products: tuple[Matrix, Matrix]) -> Matrix:
    """Return a sum of products without rounding of its terms."""
    terms = sum(
        np.abs(M) @ np.abs(N)
        + _ELSEWHERE * np.abs(M).max(axis=1, keepdims=True, initial=0.0) * np.abs(N).max(axis=0, initial=0.0)
        for M, N in products
    )
    return above_rounding(extended_sum(*products), terms, DESIGN_ROUNDING)


def signatures_of(
    responses: FaultResponses, faults: tuple[str, ...], *, rtol: float = 1e-6
) -> tuple[dict[str, Matrix], float]:
    """Return for each fault an orthonormal basis of the subspace that its residual never leaves.

    The subspace is spanned by the response to the fault at all frequencies; it follows from the singular
    values of the responses at many, each scaled to unit length. (Krylov spaces of the same would amplify
    rounding in every step.) The vector of a one-dimensional subspace has the sign of the first response to a positive
    fault, or of the response to a constant one where rounding hides the first.

    Parameters
    ----------
    responses : FaultResponses
    faults : tuple of str
    rtol : float
        Directions that carry less than this fraction of the response at every frequency, each residual in units of
        what this fault moves it by, are not there, but where those that rounding has left are much fainter still.

    Returns
    -------
    bases : dict of str to ndarray, shape (residuals, k)
        Rows of residuals that the fault does not reach are exactly zero, the others are not.
    off : float
        The largest fraction of any response, at any frequency, that was taken for rounding and left out.
    """
    units, reached, bases = residual_units(responses), responses.reached, {}
    for i, name in enumerate(faults):
        values, sizes = responses.values[:, :, i], responses.sizes[:, :, i]
        # each residual as this fault moves it: others may move it millions of times further at low frequencies; a
        # design misses the direction that it aims at by a little of the terms, hence the bound
        heights = np.where(reached[:, i], np.maximum(np.abs(values), _LEAST_ANSWER * sizes).max(axis=0), units)
        columns = _unit_columns(values.T / heights[:, None])
        if columns.shape[1] == 0:
            bases[name] = np.zeros((len(heights), 0))
            continue
        spanning = np.ones((1, 1))
        if len(heights) > 1:
            U, s, _ = np.linalg.svd(np.concatenate([columns.real, columns.imag], axis=1), full_matrices=False)
            spanning = U[:, : _dimension(s, rtol)]
        basis = np.linalg.qr((heights / responses.residuals)[:, None] * spanning)[0]
        if basis.shape[1] == 1 and basis[:, 0] @ first_response(responses, i) < 0:
            basis = -basis
        basis = np.where(reached[:, i, None], basis, 0.0)
        lost = reached[:, i] & ~np.any(basis, axis=1)  # rounding has left nothing of so small a row
        basis[lost, 0] = np.finfo(float).tiny
        bases[name] = basis
    return bases, max(outside_subspaces(responses, bases, faults).values(), default=0.0)


def _dimension(s: Matrix, rtol: float) -> int:
    """Return the number of directions, with these singular values in descending order, that a response takes.

    Those beyond ``rtol``; and fainter ones where the gap to what is rounding comes only after them. A design misses a
    direction that it aims at by what lies beyond a gap; faint directions before it are in other units of the residuals
    as large as others.
    """
    s = np.maximum(s / s[0], np.finfo(float).eps)
    gaps = s / np.append(s[1:], np.finfo(float).eps)
    kept = int(np.count_nonzero(s > rtol))
    for k in range(kept + 1, int(np.count_nonzero(s > _FADED)) + 1):
        if gaps[k - 1] > _WIDER * gaps[kept - 1]:
            kept = k
    return kept


def residual_units(responses: FaultResponses) -> Matrix:
    """Return the size of each residual: of its answers, if they are more than a little of its terms.

    Else of what it is made of, so that residuals that ignore every fault have one as well. Where a plant integrates,
    that grows without end towards low frequencies, and no answer would be a direction beside those of another residual.
    """
    values, sizes = np.abs(responses.values), responses.sizes
    answers = np.where(values > LEAKAGE * sizes, values, 0.0).max(axis=(0, 2), initial=0.0)
    units = np.where(answers > 0, answers, sizes.max(axis=(0, 2), initial=0.0))
    return np.where(units > 0, units, 1.0)


def outside_subspaces(responses: FaultResponses, spans: dict[str, Matrix], faults: tuple[str, ...]) -> dict[str, float]:
    """Return for each fault the largest fraction of its response, at any frequency, that lies outside a subspace."""
    units = residual_units(responses)
    out = {}
    for i, name in enumerate(faults):
        if len(units) == 1 and spans[name].any():  # the whole of a line: nothing lies outside
            out[name] = 0.0
            continue
        columns = _unit_columns(responses.values[:, :, i].T / units[:, None])
        basis = np.linalg.qr((responses.residuals / units)[:, None] * spans[name])[0]
        rest = columns - basis @ (basis.T @ columns)
        out[name] = float(np.linalg.norm(rest, axis=0).max(initial=0.0))
    return out


def _unit_columns(response: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the columns of a matrix with unit length, without those that are nothing beside the largest."""
    size = np.linalg.norm(response, axis=0)
    keep = (size > 0) & (size > _FAINT * size.max(initial=0.0))
    return response[:, keep] / size[keep]


def first_response(responses: FaultResponses, fault: int) -> Matrix:
    """Return the first Markov parameter ``D, C B, C A B, ...`` of one fault that is no rounding, up to a factor > 0.

    Each entry is judged against its own terms: a mode that is far faster than the others is no measure of what these
    pass on. Where rounding hides all of them it is the response at the lowest frequency. In the units of the residuals.
    """
    (A, B, C, D), reached = responses.form, responses.reached[:, fault]
    first = np.where(reached, above_rounding(D[:, fault], responses.sizes[-1, :, fault]), 0.0)
    A = A / max(float(np.linalg.norm(A)), TINY)  # only the direction matters: no power overflows
    x = B[:, fault]
    size = np.abs(x)
    for _ in range(len(A)):
        if first.any():
            break
        first = np.where(reached, above_rounding(C @ x, np.abs(C) @ size), 0.0)
        x, size = A @ x, np.abs(A) @ size
    if not first.any():
        slowest = np.flatnonzero(responses.values[:, :, fault].any(axis=1))
        first = responses.values[slowest[0], :, fault].real if slowest.size else first
    return first / responses.residuals


def steady_responses(form: StateSpace) -> NDArray[np.float64]:
    """Return the steady response to constant inputs of size one, exactly zero for rounding.

    Rounding is judged by the terms of the same response: each residual and each fault has its own units.
    """
    A, B, C = with_even_states(form)
    D = form.D
    M = (np.eye(len(A)) if form.is_discrete else 0.0) - A
    inverse = np.linalg.inv(M)
    X = inverse @ B
    gain, terms = C @ X + D, np.abs(C) @ np.abs(X) + np.abs(D)
    rounding = np.abs(C) @ (np.abs(inverse) @ (np.abs(M) @ (np.abs(inverse) @ np.abs(B))))  # of the inverse itself
    sizes = np.maximum(np.abs(B).max(axis=0, initial=0.0), np.abs(D).max(axis=0, initial=0.0))
    relative = np.abs(gain) / np.where(sizes > 0, sizes, 1.0)
    left = relative > 1e-15 * relative.max(
        axis=1, keepdims=True, initial=0.0
    )  # a direct term may be rounding of its row
    return np.where(left & (np.abs(gain) > 1e-10 * terms + 1e-13 * rounding), gain, 0.0)


def with_even_states(form: StateSpace) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return ``A``, ``B``, ``C`` with states in units in which rows and columns of ``A`` are as large."""
    if not form.n_states:
        return form.A, form.B, form.C
    A, (T, _) = scipy.linalg.matrix_balance(form.A, permute=False, separate=True)
    return A, form.B / T[:, None], form.C * T
