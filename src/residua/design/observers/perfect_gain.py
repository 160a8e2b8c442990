"""Gains of perfect observers: left inverses of a balanced pencil whose dynamics are nilpotent."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError, DesignError
from residua.linear.subspaces.quotient import observable_split, without_rounding
from residua.linear.subspaces.rank import decide_rank
from residua.linear.systems.scaling import scaling
from residua.plant import Plant
from residua.tolerances import BALANCED_RANK, IDENTITY, ROUNDING

Matrix = NDArray[np.float64]
#: A square T beyond this condition counts as singular: K = T^-1 L would be all rounding.
CONDITION = 1e8
#: Random gains that are tried for each number of chains.
_ATTEMPTS = 12


@dataclass(frozen=True, eq=False)
class PlantPencil:
    """The equations ``S X' = R X + ...`` of states and disturbances, in balanced units: those of ``n`` states, outputs.

    Attributes
    ----------
    R, S : ndarray
    n : int
    rows, columns : ndarray
        The factors from the equations of the plant to these, and from these states and disturbances to its own.
    rate : float
        The unit of rates, in 1/s.
    beta : float
        The rate at which derivatives are compared with one another: the bandwidth, or of a sampled plant one step.
    inverse, left : ndarray
        The smallest left inverse of ``R``, and orthonormal rows that annihilate ``R``.
    M, H : ndarray
        What the inverse makes of ``S``, and what a gain reads to change it.
    """

    R: Matrix
    S: Matrix
    n: int
    rows: Matrix
    columns: Matrix
    rate: float
    beta: float
    inverse: Matrix
    left: Matrix
    M: Matrix
    H: Matrix

    @classmethod
    def of(cls, plant: Plant, outputs: list[int], bandwidth: float) -> PlantPencil:
        """Return that of a plant and some of its outputs; its controls have no part in it, nor in its units."""
        model, n, first = plant.balanced, plant.n_states, len(plant.inputs)
        (A, C, E), units = model.written, model.units
        d, Y = units.inputs[first : first + len(plant.disturbances)], units.outputs[outputs]
        e = units.equations / units.rate
        B, C, D = e[:, None] * plant.Bd * d, C[outputs], Y[:, None] * plant.Dd[outputs] * d
        # not rounded to powers of two: the smallest gains are to be the same in all units
        equations, states, heights, unit = scaling(A, B, C, D, E, sampled=plant.is_discrete).exact
        rows = np.concatenate([equations / unit, heights])
        inputs = np.abs(rows[:, None] * np.vstack([B, D])).max(axis=0, initial=0.0)
        columns = np.concatenate([states, 1 / np.where(inputs > 0, inputs, 1.0)])
        R, S = rows[:, None] * np.block([[A, B], [C, D]]) * columns, np.zeros((len(rows), len(columns)))
        S[:n, :n] = equations[:, None] * E * states
        rows, columns = rows * np.concatenate([e, Y]), columns * np.concatenate([units.states, d])
        rate = units.rate * unit
        beta = 1.0 if plant.dt else bandwidth / rate
        inverse = np.asarray(np.linalg.pinv(R), dtype=np.float64)
        left = without_rounding(np.linalg.svd(R)[0][:, R.shape[1] :].T)
        return cls(R, S, n, rows, columns, rate, beta, inverse, left, inverse @ S, left @ S)


@dataclass(frozen=True, eq=False)
class PerfectGain:
    """``G R = I`` with ``N = G S`` nilpotent, in balanced units, and its accuracy.

    Attributes
    ----------
    pencil : PlantPencil
    G : ndarray, shape (states + disturbances, equations)
        ``[T, L]``.
    basis, triangular : ndarray
        ``N = basis triangular basis'`` with a strictly lower triangular matrix: its powers do not cancel.
    index : int
        The smallest ``k`` with ``N^k = 0``.
    condition : float
        Of ``T``.
    missed, dropped : float
        Of the identity; what of ``G S`` was set to zero.
    size : float
        ``sum_i |N^i L| beta^i``: what measurement noise within the bandwidth becomes.
    """

    pencil: PlantPencil
    G: Matrix
    basis: Matrix
    triangular: Matrix
    index: int
    condition: float
    missed: float
    dropped: float
    size: float


def deadbeat(M: Matrix, H: Matrix) -> tuple[Matrix, Matrix, list[int]] | None:
    """Return ``Z`` with ``M + Z H`` nilpotent, of the least index, and a basis in which it is block triangular.

    The dual of deadbeat control: with ``S_0 = 0`` and ``S_{i+1}`` all ``x`` that some ``u`` brings into ``S_i``,
    ``M' x + H' u``, the ``u`` of least norm for the new directions of each step make up ``Z'``. Unobservable modes
    at zero are carried along; any other makes the steps end early, which returns None. The last is how many directions
    each step has found.
    """
    A, B = M.T, H.T
    X, Y, F, levels = np.zeros((len(M), 0)), np.eye(len(M)), np.zeros(H.shape), []
    while Y.shape[1]:
        U, s, Vh = np.linalg.svd(Y.T @ B, full_matrices=False)
        U, s, Vh = U[:, s > BALANCED_RANK], s[s > BALANCED_RANK], Vh[s > BALANCED_RANK]
        inside = Y.T @ A @ Y
        _, t, Wh = np.linalg.svd(inside - U @ (U.T @ inside))
        count = int(np.count_nonzero(t <= BALANCED_RANK * max(1.0, float(np.linalg.norm(M, 2)))))
        if not count:
            return None
        fresh = Y @ Wh[-count:].T
        F = F - Vh.T / s @ U.T @ Y.T @ A @ fresh @ fresh.T
        X, Y = np.hstack([X, fresh]), Y @ Wh[:-count].T
        levels.append(count)
    return F.T, X, levels


def nilpotency_index(N: Matrix) -> int:
    """Return the smallest ``k`` with ``N^k = 0``; entries count as zero against the terms that they are sums of."""
    N = N / (np.abs(N).max(initial=0.0) or 1.0)
    power, terms = np.eye(len(N)), np.eye(len(N))
    for k in range(len(N) + 1):
        if not np.any(np.abs(power) > ROUNDING * terms):
            return k
        power, terms = power @ N, terms @ np.abs(N)
    return len(N) + 1


def _finished(p: PlantPencil, Z: Matrix, X: Matrix, levels: list[int]) -> PerfectGain:
    """Return the gain of a choice of ``Z``, checked."""
    G = p.inverse + Z @ p.left
    full, ends = X.T @ G @ p.S @ X, np.repeat(np.cumsum(levels), levels)
    # the basis is one of N': N maps each group of directions into those after it
    kept = np.where(np.arange(len(full))[:, None] >= ends, full, 0.0)
    size, power = 0.0, X.T @ G[:, p.n :]
    with np.errstate(over="ignore", invalid="ignore"):  # powers of what is not nilpotent, which is refused later
        for i in range(len(kept)):
            size, power = size + float(np.linalg.norm(power)) * p.beta**i, kept @ power
    return PerfectGain(
        p,
        G,
        X,
        kept,
        nilpotency_index(kept),
        float(np.linalg.cond(G[:, : p.n])) if p.n else 1.0,
        float(np.linalg.norm(G @ p.R - np.eye(len(G)))),
        float(np.linalg.norm(full - kept)) / max(1.0, float(np.linalg.norm(full))),
        size,
    )


def least_order_gain(p: PlantPencil) -> PerfectGain:
    """Return the gain of least nilpotency index; ``T`` may lack rank."""
    found = deadbeat(p.M, p.H)
    if found is None:
        raise AccuracyError(_NO_STEPS)
    return _finished(p, *found)


def full_rank_gain(p: PlantPencil, seed: int) -> PerfectGain:
    """Return the best of some random gains whose ``T`` has full column rank: of the least index, with the least noise.

    The observable part of ``(H, M)`` is made nilpotent through ``t`` random combinations of ``H``, which gives it
    ``t`` chains; random gains into the unobservable part, nilpotent by itself, hang its chains on to them. Each
    dimension of the null space of ``S`` ends one chain, which bounds ``t``: the most chains are tried first.
    """
    P, s, _ = np.linalg.svd(p.H)
    seeing = P[:, : np.count_nonzero(s > BALANCED_RANK)]
    E, both = (decide_rank(M, rtol=BALANCED_RANK, scale=1.0).rank for M in (p.S, np.vstack([p.S[: p.n], p.R[p.n :]])))
    most = min(len(p.M) - E, seeing.shape[1])
    conditions: list[float] = []
    # what sees nothing of the equations is not read, such as a dead sensor, but where T is singular without it
    for reading in (seeing @ seeing.T, np.eye(len(p.H))):
        rng = np.random.default_rng(seed)
        for chains in range(most, 0, -1) if most else [0]:
            tried = [
                gain for gain in _random_gains(p, reading, chains, rng) if max(gain.missed, gain.dropped) <= IDENTITY
            ]
            conditions += [gain.condition for gain in tried]
            good = [gain for gain in tried if gain.condition <= CONDITION]
            if good:
                return min(good, key=lambda gain: (gain.index, gain.size))
    if not conditions:
        raise AccuracyError(_NO_STEPS)
    raise DesignError(
        f"no gain K makes det(sE - A - KC) constant: every T that was tried is singular (condition "
        f"{min(conditions):.2g} at least), for the outputs see {both - E} dimension(s) of what algebraic equations "
        "alone determine, rank[E; C] - rank E; least_order=True estimates the state all the same, or add a sensor"
    )


def _random_gains(p: PlantPencil, reading: Matrix, chains: int, rng: np.random.Generator) -> Iterator[PerfectGain]:
    """Yield random gains with some number of chains in the observable part."""
    split = observable_split(p.M, p.H)
    O, U = split.seen, split.hidden  # noqa: E741
    M, H = p.M, p.H @ O
    rest = deadbeat(U.T @ M @ U, np.zeros((0, U.shape[1])))
    # what moves N as much as it is large already; without anything to move, what moves G as much
    whole, seen = float(np.linalg.norm(M, 2)), float(np.linalg.norm(H, 2)) if H.size else 0.0
    size = whole / seen if seen and whole else float(np.linalg.norm(p.inverse, 2))
    for attempt in range(_ATTEMPTS if rest else 0):
        strength = size * (0.1, 0.3, 1.0)[attempt % 3]
        # drawn for all equations and states: the same whatever bases these have here
        mix = rng.standard_normal((chains, len(p.R))) @ p.left.T
        mix = np.linalg.qr(mix.T)[0].T if chains else mix
        drawn = strength * rng.standard_normal((len(M), len(p.R))) @ p.left.T
        # few combinations see the observable part only when it has no repeated mode: a random gain sees to that
        found = deadbeat(O.T @ M @ O + O.T @ drawn @ H, mix @ H)
        if found is None or rest is None:
            continue
        Z = (drawn + O @ found[0] @ mix) @ reading
        # N = [N11 0; N21 N22] in these coordinates: the observable group comes first
        yield _finished(p, Z, np.hstack([O @ found[1], U @ rest[1]]), [*found[2], *rest[2]])


def given_gain(p: PlantPencil, K: Matrix) -> PerfectGain:
    """Return the inverse of ``K`` of ``E xh' = A xh + B u + K (C xh - y)``, or raise for one that is not perfect."""
    whole = np.hstack([np.eye(p.n), p.rows[: p.n, None] * K / p.rows[p.n :]])
    Ab = whole @ p.R
    condition = float(np.linalg.cond(Ab))
    if not condition < CONDITION:
        raise DesignError(f"A + K C is singular (condition {condition:.2g}): det(sE - A - KC) is zero at s = 0")
    G = np.linalg.solve(Ab, whole)
    found = deadbeat(G @ p.S, np.zeros((0, p.n)))
    if found is None:
        modes = np.linalg.eigvals(G @ p.S) / p.rate
        raise DesignError(
            f"det(sE - A - KC) is not constant: (A + KC)^-1 E has the eigenvalue {modes[np.argmax(np.abs(modes))]:.4g} "
            "instead of zeros; leave K out and it is designed"
        )
    return _finished(p, (G - p.inverse) @ p.left.T, found[1], found[2])


_NO_STEPS = (
    "the deadbeat steps of the design do not end: a rank decision was not clear, or a finite zero of the pencil is too "
    "near; add a sensor, or use an unknown input observer, which has dynamics"
)
