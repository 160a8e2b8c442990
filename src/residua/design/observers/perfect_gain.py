"""Gains of perfect observers: left inverses of a plant's pencil whose dynamics are nilpotent."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from residua.design.core.own_time import has_rates, written_by
from residua.errors import AccuracyError, DesignError
from residua.linear.subspaces.observability import staircase
from residua.linear.subspaces.parts import row_parts
from residua.linear.subspaces.rank import (
    decide_rank,
    null_basis,
    range_basis,
    spectral_norm,
    without_noise,
    without_rounded_gains,
)
from residua.linear.systems.units import pencil_units
from residua.tolerances import IDENTITY, RESIDUE, ROUNDING, above_rounding
from residua.words import unit_of_rates

Matrix = NDArray[np.float64]
#: Largest relative variation of det(sN - I), which has to be constant, over the tried s.
VARIATION = 1e-6
#: A square T beyond this condition counts as singular: K = T^-1 L would be all rounding.
CONDITION = 1e8
_ATTEMPTS = 12
#: From so many rows on null spaces are iterated, and single chains are those of Arnoldi.
_LARGE = 24
#: Steps of a chain that are larger than this fraction of what they are made of are not rounding.
_SURE = 1e-6


def _in_other_time(gain: PerfectGain, factor: float) -> PerfectGain:
    """Return a gain with what belongs to the equations of the states in another unit of time."""
    equations = np.where(np.arange(gain.W.shape[1]) < gain.T.shape[1], 1 / factor, 1.0)
    return replace(gain, W=gain.W * equations, Y=gain.Y / equations[:, None])


@has_rates(T=-1, N=-1, triangular=-1)
@written_by(_in_other_time)
@dataclass(frozen=True, eq=False)
class PerfectGain:
    """``T [A Bd] + L [C Dd] = I`` with ``N = T [E 0]`` nilpotent, and how well.

    Attributes
    ----------
    T, L, N : ndarray
        In the units of the plant.
    basis, triangular, inverse : ndarray
        ``N = basis triangular inverse`` with a strictly lower triangular matrix: its powers do not cancel.
    W : ndarray, shape (outputs - disturbances, equations)
        ``W [A Bd; C Dd] = 0``: the combinations of equations that the estimate leaves over.
    Y : ndarray, shape (equations, outputs - disturbances)
        ``W Y = I`` and ``[T L] Y = 0``: the errors of all equations, made of those.
    index : int
        The smallest ``k`` with ``N^k = 0``.
    condition : float
        Of ``T``, in scaled units.
    missed, dropped, variation : float
        Of the identity; what of ``T [E 0]`` was set to zero; relative variation of ``det(sN - I)``.
    size : float
        ``sum_i |N^i L| beta^i`` in scaled units: what measurement noise within the bandwidth becomes.
    """

    T: Matrix
    L: Matrix
    N: Matrix
    basis: Matrix
    triangular: Matrix
    inverse: Matrix
    W: Matrix
    Y: Matrix
    index: int
    condition: float
    missed: float
    dropped: float
    variation: float
    size: float

    @property
    def passes(self) -> bool:
        """Whether every check is passed."""
        return self.missed <= IDENTITY and self.dropped <= IDENTITY and self.variation <= VARIATION


@dataclass(frozen=True, eq=False)
class _Problem:
    """The pencil ``s S - R`` in scaled units with a left inverse of ``R``, and what goes back to the plant's units."""

    R: Matrix
    S: Matrix
    inverse: Matrix
    left: Matrix
    rows: Matrix
    columns: Matrix
    unit: float
    n: int
    rtol: float
    beta: float

    @cached_property
    def M(self) -> Matrix:
        return self.inverse @ self.S

    @cached_property
    def size(self) -> float:
        """The largest singular value of ``M``."""
        return float(np.linalg.norm(self.M, 2))

    @cached_property
    def H(self) -> Matrix:
        H = self.left @ self.S
        # Redundant outputs alone give an H that is rounding, which nothing may be divided by.
        return H if float(np.linalg.norm(H)) > self.rtol * float(np.linalg.norm(self.S)) else np.zeros_like(H)

    @cached_property
    def rounding(self) -> float:
        """The size that ``M`` is judged by at least: rounding of its factors counts as zero."""
        return 1e-4 * float(np.linalg.norm(self.inverse) * np.linalg.norm(self.S))


def _problem(
    R0: Matrix, S0: Matrix, n: int, rtol: float, bandwidth: float | None, inputs: Matrix | None = None
) -> _Problem:
    """Return the scaled problem; parts that nothing connects have the units that inputs to both give them."""
    u = pencil_units(R0, S0)  # of the entries alone: sweeps that even norms run away where parts lead one way only
    if inputs is not None and len(row_parts(np.hstack([R0, S0]))) > 1:
        both = pencil_units(np.hstack([R0, inputs]), np.hstack([S0, np.zeros_like(inputs)]))
        u = replace(both, columns=both.columns[: R0.shape[1]])
    R, S = u.rows[:, None] * R0 * u.columns, u.unit * u.rows[:, None] * S0 * u.columns
    width = R.shape[1]
    Q, upper = np.linalg.qr(R, mode="complete")
    inverse = np.linalg.solve(upper[:width], Q[:, :width].T)
    inverse = inverse + (np.eye(width) - inverse @ R) @ inverse
    beta = 1.0 if bandwidth is None else bandwidth / u.unit
    return _Problem(R, S, inverse, without_noise(Q[:, width:]).T, u.rows, u.columns, u.unit, n, rtol, beta)


def _deadbeat(M: Matrix, H: Matrix, rtol: float, scale: float) -> tuple[Matrix, Matrix, list[int]] | None:
    """Return ``Z`` with ``M + Z H`` nilpotent, of the least index, and a basis in which it is block triangular.

    The dual of deadbeat control: with ``S_0 = 0`` and ``S_{i+1}`` all ``x`` that some ``u`` brings into ``S_i``,
    ``M' x + H' u``, the ``u`` of least norm for the new directions of each step make up ``Z'``. Unobservable modes
    at zero are carried along; any other makes the steps end early, which returns None. ``scale`` is the size of what
    ``M`` is a part of.
    """
    c, k = M.shape[0], H.shape[0]
    At, Bt = M.T, H.T
    scale_A = max(spectral_norm(M), scale, np.finfo(float).tiny)
    scale_B = max(spectral_norm(H), np.finfo(float).tiny)
    if k == 1 and c >= _LARGE:
        sure, chain = _single_chain(At, Bt[:, 0], rtol, scale_A)
        if sure:
            return chain
    X, Y, F, levels = np.zeros((c, 0)), np.eye(c), np.zeros((k, c)), []
    inside, reach = At, Bt  # in the complement of X, of which Y is a basis
    steps: list[tuple[int, NDArray]] = []
    while X.shape[1] < c:
        basis, inverse = _range_and_inverse(reach, rtol * scale_B)
        kernel = _kernel(inside - basis @ (basis.T @ inside), rtol, scale_A)
        count = kernel.shape[1]
        if not count:
            return None
        inverse = inverse @ Y.T
        fresh = Y @ kernel
        fresh = np.linalg.qr(fresh - X @ (X.T @ fresh))[0]
        steps.append((X.shape[1], inverse))
        F = F - (inverse @ (At @ fresh)) @ fresh.T
        X = np.hstack([X, fresh])
        Y, inside, reach = _complement(kernel, Y, inside, reach)
        levels.append(count)
    for _ in range(2):  # what rounding left below the diagonal blocks is taken out once more
        for (start, inverse), count in zip(steps, levels, strict=True):
            fresh = X[:, start : start + count]
            lost = At @ fresh + Bt @ (F @ fresh)
            lost = lost - X[:, :start] @ (X[:, :start].T @ lost)
            F = F - inverse @ lost @ fresh.T
    return F.T, X, levels


def _range_and_inverse(M: Matrix, tolerance: float) -> tuple[Matrix, Matrix]:
    """Return an orthonormal basis of the column space of a matrix and its inverse there, by one decomposition."""
    if not M.size:
        return np.zeros((len(M), 0)), np.zeros(M.shape[::-1])
    U, s, Vh = np.linalg.svd(M, full_matrices=False)
    rank = int(np.count_nonzero(s > tolerance))
    return without_noise(U[:, :rank]), (Vh[:rank].T / s[:rank]) @ U[:, :rank].T


def _complement(kernel: Matrix, Y: Matrix, inside: Matrix, reach: Matrix) -> tuple[Matrix, Matrix, Matrix]:
    """Return a basis, a matrix and an input in the orthogonal complement of some directions.

    Reflections turn the directions to the first coordinates, which are left out then: each is orthogonal to rounding.
    """
    count = kernel.shape[1]
    factors, scales, _, _ = lapack.dgeqrf(kernel)
    for j in range(count):
        v = factors[:, j].copy()
        v[:j], v[j] = 0.0, 1.0
        turned = scales[j] * v
        Y = Y - np.outer(Y @ v, turned)
        inside = inside - np.outer(inside @ v, turned)
        inside = inside - np.outer(turned, v @ inside)
        reach = reach - np.outer(turned, v @ reach)
    return Y[:, count:], inside[count:, count:], reach[count:]


def _single_chain(
    At: Matrix, b: Matrix, rtol: float, scale: float
) -> tuple[bool, tuple[Matrix, Matrix, list[int]] | None]:
    """Return what `_deadbeat` does of one input and a regular matrix, at a hundredth of the time, and if that is sure.

    The ``x`` that the input brings into ``S_i`` are ``At^-1 b, ..., At^-i b``: the basis is that of Arnoldi. Sure are
    steps far above rounding with a result of the right form; and steps of less than rounding, where there is none.
    """
    c, size = len(b), float(b @ b)
    factors, pivots, singular = lapack.dgetrf(At)
    if singular or lapack.dgecon(factors, np.linalg.norm(At, 1))[0] < _SURE:
        return False, None
    X, F, left = np.zeros((c, c)), np.zeros(c), np.zeros((c, c))
    x, rest, outside = b, b, size
    for i in range(c):
        outside = float(rest @ rest)
        if outside <= (rtol / 100) ** 2 * size:
            return True, None
        x = lapack.dgetrs(factors, pivots, x)[0]
        length = float(np.linalg.norm(x))
        for _ in range(2):
            x = x - X[:, :i] @ (X[:, :i].T @ x)
        if not np.linalg.norm(x) > _SURE * length:
            return False, None
        x = X[:, i] = x / np.linalg.norm(x)
        left[i] = rest / outside  # reads of a vector what the input takes out of it, in the complement of S_i
        rest = rest - x * (x @ rest)
    if outside <= _SURE**2 * size:
        return False, None
    for _ in range(3):
        lost = At @ X + np.outer(b, F @ X)
        F = F - np.einsum("ij,ji->i", left, lost) @ X.T
    form = X.T @ (At @ X + np.outer(b, F @ X))
    fits = np.linalg.norm(np.tril(form)) <= RESIDUE * c * max(scale, float(np.linalg.norm(form)))
    return (True, (F[:, None], X, [1] * c)) if fits else (False, None)


def _kernel(M: Matrix, rtol: float, scale: float) -> Matrix:
    """Return an orthonormal basis of the null space of a square matrix; of a large one by inverse iteration.

    The rank is decided by all singular values either way; to compute the vectors of all takes three times as long.
    """
    if len(M) < _LARGE:
        return null_basis(M, rtol=rtol, scale=scale)[0]
    decision = decide_rank(M, rtol=rtol, scale=scale)
    s, count = decision.singular_values, len(M) - decision.rank
    if not count or 4 * count > len(M):
        return null_basis(M, rtol=rtol, scale=scale)[0]
    factors, pivots, _ = lapack.dgetrf(M)
    diagonal, least = factors.diagonal(), float(np.finfo(float).eps * s[0])
    np.fill_diagonal(factors, np.where(np.abs(diagonal) < least, least, diagonal))
    Z = np.random.default_rng(3).standard_normal((len(M), count))
    for _ in range(2):
        Z = lapack.dgetrs(factors, pivots, lapack.dgetrs(factors, pivots, Z, trans=1)[0])[0]
        Z = np.linalg.qr(Z)[0]
    if not np.linalg.norm(M @ Z) <= max(2 * s[len(M) - count], RESIDUE * s[0]):  # no gap behind the values
        return null_basis(M, rtol=rtol, scale=scale)[0]
    return without_noise(Z)


def _triangular(N: Matrix, X: Matrix, levels: list[int], size: float) -> tuple[Matrix, float]:
    """Return ``X' N X`` with exact zeros where the nilpotent form has them, and what was dropped, over ``size``."""
    full = X.T @ N @ X
    kept = np.zeros_like(full)
    start = 0
    for count in levels:
        # The basis is one of N': N maps each group of directions into those after it.
        kept[start + count :, start : start + count] = full[start + count :, start : start + count]
        start += count
    kept[np.abs(kept) <= 1e-13 * size] = 0.0
    return kept, float(np.linalg.norm(full - kept)) / max(size, np.finfo(float).tiny)


def nilpotency_index(N: Matrix) -> int:
    """Return the smallest ``k`` with ``N^k = 0``; entries count as zero against the terms that they are sums of."""
    below = np.diagonal(N, -1)
    if not np.triu(N).any() and below.all():  # one chain: the last entry of its longest power is the product of these
        return len(N)
    power, terms = np.eye(len(N)), np.eye(len(N))
    for k in range(len(N) + 1):
        if not np.any(np.abs(power) > ROUNDING * terms):
            return k
        power, terms = power @ N, terms @ np.abs(N)
    return len(N) + 1


def _finished(p: _Problem, Z: Matrix, X: Matrix, levels: list[int]) -> PerfectGain:
    """Return the gain of a choice of ``Z``, checked and in the units of the plant."""
    G = p.inverse + Z @ p.left
    G = G + (np.eye(len(G)) - G @ p.R) @ G
    # an output that rounding reads would be all that there is of a state that nothing moves
    G = without_rounded_gains(G)
    actual = G @ p.S
    # In these units states and equations are of the size of one, so that is what errors count against.
    kept, dropped = _triangular(actual, X, levels, max(1.0, float(np.linalg.norm(actual))))
    N = X @ kept @ X.T
    T = G[:, : p.n]
    missed = float(np.linalg.norm(G @ p.R - np.eye(len(G))))
    back = p.columns[:, None] * G * p.rows
    # what rounding leaves of an error that is always nothing would be all that there is of an output
    errors, terms = p.left.T - p.R @ (G @ p.left.T), np.abs(p.R) @ (np.abs(G) @ np.abs(p.left.T))
    errors = above_rounding(errors, np.abs(p.left.T) + terms)
    return PerfectGain(
        back[:, : p.n],
        back[:, p.n :],
        p.columns[:, None] * N / p.columns / p.unit,
        p.columns[:, None] * X,
        kept / p.unit,
        X.T / p.columns,
        p.left * p.rows,
        errors / p.rows[:, None],
        nilpotency_index(kept),
        float(np.linalg.cond(T)) if T.size else 1.0,
        missed,
        dropped,
        determinant_variation(actual),
        _noise(N, G[:, p.n :], p.beta),
    )


def determinant_variation(N: Matrix) -> float:
    """Return the largest relative distance of ``det(sN - I)`` from ``det(-I)`` over points around the unit circle."""
    points = np.array([0.3, 1.0, 2.0]) * np.exp(1j * np.array([0.7, 2.1, 2.9]))
    size = len(N)
    return max((abs(np.linalg.det(np.eye(size) - s * N) - 1.0) for s in points), default=0.0) if size else 0.0


def _noise(N: Matrix, L: Matrix, beta: float) -> float:
    total, power = 0.0, L
    with np.errstate(over="ignore", invalid="ignore"):  # powers of what is not nilpotent, which is refused later
        for i in range(len(N)):
            total += float(np.linalg.norm(power)) * beta**i
            power = N @ power
    return total


def least_order_gain(R: Matrix, S: Matrix, n: int, *, rtol: float, bandwidth: float | None) -> PerfectGain:
    """Return the gain of least nilpotency index; ``T`` may lack rank."""
    p = _problem(R, S, n, rtol, bandwidth)
    deadbeat = _deadbeat(p.M, p.H, rtol, p.rounding)
    if deadbeat is None:
        raise AccuracyError(_no_steps(rtol))
    gain = _finished(p, *deadbeat)
    if not gain.passes:
        raise AccuracyError(_missed(gain))
    return gain


def full_rank_gain(
    R: Matrix, S: Matrix, n: int, *, inputs: Matrix, rtol: float, bandwidth: float | None, seed: int
) -> PerfectGain:
    """Return the best of many gains whose ``T`` has full column rank: least index first, then least noise.

    The observable part of ``(H, M)`` is made nilpotent through ``t`` random combinations of ``H``, which gives it
    ``t`` chains; random gains into the unobservable part, nilpotent by itself, hang its chains on to them. Each
    dimension of the null space of ``S`` ends one chain, which bounds ``t``. Chains of one part may hang on to those of
    another that nothing connects with it, but the control inputs, whose columns are ``inputs``.
    """
    p = _problem(R, S, n, rtol, bandwidth, inputs)
    rng = np.random.default_rng(seed)
    form = staircase(p.M, p.H, units="given")
    c = len(p.M)
    ends = c - int(np.count_nonzero(np.linalg.svd(p.S, compute_uv=False) > rtol))
    candidates: list[PerfectGain] = []
    good: list[PerfectGain] = []
    for seeing in (True, False):  # an algebraic equation sees nothing of N, and T may be singular without it
        for t in range(min(ends, form.n_seen), 0, -1) if form.n_seen else [0]:
            for attempt in range(_ATTEMPTS):
                gain = _attempt(p, form.Q, form.n_observable, t, rng, attempt, seeing)
                if gain is not None:
                    candidates.append(gain)
        good = [g for g in candidates if g.passes and g.condition <= CONDITION]
        if good:
            break
    if not good:
        if not candidates:
            raise AccuracyError(_no_steps(rtol))
        if any(g.passes for g in candidates):
            raise DesignError(_no_full_rank(p, min(g.condition for g in candidates if g.passes)))
        raise AccuracyError(_missed(min(candidates, key=lambda g: max(g.variation / VARIATION, g.dropped / IDENTITY))))
    quietest = min(g.size for g in good)
    return min((g for g in good if g.size <= 100 * quietest), key=lambda g: (g.index, g.size))


def _attempt(
    p: _Problem, Q: Matrix, k: int, t: int, rng: np.random.Generator, attempt: int, seeing: bool
) -> PerfectGain | None:
    """Return one gain of `full_rank_gain`, or None if the deadbeat steps break down.

    ``seeing``: only what sees something of the equations is read, not a dead sensor, which changes nothing of N.
    """
    c, count = len(p.M), len(p.H)
    Qo, Qu = Q[:, :k], Q[:, k:]
    Ho = p.H @ Qo
    whole, seen = p.size, spectral_norm(Ho)
    # What moves N as much as it is large already; without anything to move, what moves G as much.
    size = whole / seen if seen > p.rtol and whole > p.rtol else float(np.linalg.norm(p.inverse, 2))
    strength = size * (0.1, 0.3, 1.0)[attempt % 3]
    mix = np.linalg.qr(rng.standard_normal((count, t)))[0].T if t else np.zeros((0, count))
    # Few combinations see the observable part only when it has no repeated mode: a random gain sees to that.
    Z0 = strength * rng.standard_normal((k, count)) if attempt or t < count else np.zeros((k, count))
    M11 = Qo.T @ p.M @ Qo + Z0 @ Ho
    floor = max(whole, p.rounding)
    first = _deadbeat(M11, mix @ Ho, p.rtol, floor)
    second = _deadbeat(Qu.T @ p.M @ Qu, np.zeros((0, c - k)), p.rtol, floor)
    if first is None or second is None:
        return None
    Z1 = Z0 + first[0] @ mix
    Z2 = strength * rng.standard_normal((c - k, count))
    if attempt % 2 and Ho.size:
        Z2 = Z2 - Qu.T @ p.M @ Qo @ np.linalg.pinv(Ho, rcond=p.rtol)
    Z = Qo @ Z1 + Qu @ Z2
    if seeing:
        seen_by = range_basis(p.H, rtol=p.rtol)[0]
        Z = Z @ seen_by @ seen_by.T
    # N = [N11 0; N21 N22] in the staircase coordinates: the observable group comes first.
    X = np.hstack([Qo @ first[1], Qu @ second[1]])
    return _finished(p, Z, X, [*first[2], *second[2]])


def given_gain(A: Matrix, E: Matrix, C: Matrix, K: Matrix, *, rtol: float, bandwidth: float | None) -> PerfectGain:
    """Return what ``K`` of ``E xh' = A xh + B u + K (C xh - y)`` achieves, or raise when it is not perfect."""
    Ab = A + K @ C
    R, S = np.vstack([A, C]), np.vstack([E, np.zeros_like(C)])
    p = _problem(R, S, len(A), rtol, bandwidth)
    scaled = p.rows[: len(A), None] * Ab * p.columns
    condition = float(np.linalg.cond(scaled))
    if not condition < CONDITION:
        raise DesignError(f"A + K C is singular (condition {condition:.2g}): det(sE - A - KC) is zero at s = 0")
    Ti = np.linalg.inv(scaled)
    G = np.hstack([Ti, Ti @ (p.rows[: len(A), None] * K / p.rows[len(A) :])])
    deadbeat = _deadbeat(G @ p.S, np.zeros((0, len(A))), rtol, p.rounding)
    if deadbeat is None:
        modes = np.linalg.eigvals(G @ p.S)
        worst = modes[np.argmax(np.abs(modes))] / (p.unit * unit_of_rates())  # in seconds
        raise DesignError(
            f"det(sE - A - KC) is not constant: (A + KC)^-1 E has the eigenvalue {worst:.4g} instead of zeros; leave K "
            "out and it is designed"
        )
    Z = (G - p.inverse) @ p.left.T
    gain = _finished(p, Z, deadbeat[1], deadbeat[2])
    if not gain.passes:
        raise AccuracyError(_missed(gain))
    return gain


def _no_full_rank(p: _Problem, condition: float) -> str:
    E = decide_rank(p.S, rtol=p.rtol).rank
    seen = decide_rank(np.vstack([p.S[: p.n], p.R[p.n :]]), rtol=p.rtol).rank - E
    return (
        f"no gain K makes det(sE - A - KC) constant: every T that was tried is singular (condition {condition:.2g} at "
        f"least), for the outputs see {seen} dimension(s) of what algebraic equations alone determine, rank[E; C] - "
        "rank E; least_order=True estimates the state all the same, or add a sensor"
    )


def _no_steps(rtol: float) -> str:
    return (
        f"the deadbeat steps of the design do not end: a rank decision with rtol={rtol:.3g} was not clear, or a finite "
        "zero of the pencil is too near; choose another rtol, rescale the plant, or add a sensor"
    )


def _missed(gain: PerfectGain) -> str:
    return (
        f"the perfect observer misses its checks: det(sN - I) varies by {gain.variation:.2g} (at most "
        f"{VARIATION:.0e}), its identity is missed by {gain.missed:.2g} and its nilpotent form by "
        f"{gain.dropped:.2g} (at most {IDENTITY:.0e}), condition of T {gain.condition:.2g}; rescale the plant, add a "
        "sensor, try another seed, or use an unknown input observer, which has dynamics"
    )
