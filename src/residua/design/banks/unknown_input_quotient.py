"""What is left of a plant when everything that must be ignored is divided out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.design.core.signals import signal_names
from residua.linear import StateSpace
from residua.linear.subspaces.detection_space import confining_gain, detection_space
from residua.linear.subspaces.parts import rows_by_parts
from residua.linear.subspaces.rank import (
    RankDecision,
    decide_rank,
    left_null_basis,
    range_basis,
    spectral_norm,
    without_noise,
    without_slight_mixing,
)
from residua.linear.subspaces.reachability import reachable_basis
from residua.linear.systems.array_cache import cached_by_contents
from residua.linear.systems.balancing import descriptor_units, without_rounding
from residua.plant import Plant
from residua.tolerances import RESIDUE, ROUNDING, above_rounding


@dataclass(frozen=True, eq=False)
class ExplicitParts:
    """A plant in balanced units, as ordinary state equations with further unknown inputs and known outputs.

    With ``E = U diag(S, 0) V'`` the states that ``E`` does not see are unknown inputs, and the equations without
    derivatives are outputs that are known to be zero.
    """

    A: NDArray
    C: NDArray
    B: NDArray
    D: NDArray
    derivative: NDArray  # T1 with x1' = T1 (A x + ...), x1 = T1 E x
    algebra: NDArray  # rows that annihilate E
    process_noise: NDArray
    measurement_noise: NDArray
    equations: NDArray
    outputs: NDArray


def explicit_parts(plant: Plant) -> ExplicitParts:
    """Return the plant with everything that must be ignored as unknown inputs ``B``, ``D``."""
    n = plant.n_states
    units = descriptor_units(
        plant.A,
        plant.E,
        np.hstack([plant.B, plant.Bd, plant.Bf]),
        plant.C,
        np.hstack([plant.D, plant.Dd, plant.Df]),
    )
    R, S, Y = units.equations[:, None], units.states, units.outputs[:, None]
    A, C = R * plant.A * S, Y * plant.C * S
    unknown = np.vstack([R * plant.Bd, Y * plant.Dd])
    size = np.linalg.norm(unknown, axis=0)
    unknown = unknown / np.where(size > 0, size, 1.0)
    B, D = unknown[:n], unknown[n:]
    noise, seen = R * plant.Bw, Y * plant.Dw
    if plant.E is None:
        return ExplicitParts(A, C, B, D, np.eye(n), np.zeros((0, n)), noise, seen, units.equations, units.outputs)
    E = R * plant.E * S
    U, s, Vh = np.linalg.svd(E)
    k = decide_rank(E).rank
    derivative, algebra = U[:, :k].T / s[:k, None], _without_rounding(U[:, k:].T)
    V1, V2 = Vh[:k].T, Vh[k:].T
    size2 = np.maximum(np.linalg.norm(A @ V2, axis=0), np.linalg.norm(C @ V2, axis=0))
    V2 = V2 / np.where(size2 > 0, size2, 1.0)
    return ExplicitParts(
        derivative @ A @ V1,
        np.vstack([C @ V1, algebra @ A @ V1]),
        np.hstack([derivative @ A @ V2, derivative @ B]),
        np.vstack([np.hstack([C @ V2, D]), algebra @ np.hstack([A @ V2, B])]),
        derivative,
        algebra,
        derivative @ noise,
        np.vstack([seen, algebra @ noise]),
        units.equations,
        units.outputs,
    )


@dataclass(frozen=True, eq=False)
class Quotient:
    """What is left when the unknown inputs are divided out: ``z' = A z + inject eta``, ``0 = read eta - C z``."""

    A: NDArray
    C: NDArray
    T1: NDArray  # z = T1 E x, before the algebraic equations take part
    inject: NDArray
    read: NDArray
    process_noise: NDArray
    measurement_noise: NDArray
    direct: RankDecision


@cached_by_contents
def unknown_input_quotient(parts: ExplicitParts, rtol: float) -> Quotient:
    """Divide out the smallest unobservability subspace that holds the unknown inputs."""
    U, s, Vh = np.linalg.svd(parts.D)
    U, Vh = without_noise(U), without_noise(Vh)  # a reading of rounding would couple states to the residual
    direct = decide_rank(parts.D, rtol=rtol, scale=1.0)
    k = direct.rank
    G = without_rounding(parts.B, Vh[:k].T / s[:k], U[:, :k].T)  # of nothing it would leave couplings
    W = _left_null_rows(parts.D, rtol, 1.0)
    A = without_rounding(np.hstack([np.eye(len(parts.A)), -G]), np.vstack([parts.A, parts.C]))
    C = without_rounding(W, parts.C)
    L, _ = range_basis(parts.B @ Vh[k:].T, rtol=rtol, scale=1.0)
    S = detection_space(A, C, L, rtol=rtol).basis if L.shape[1] else _unobservable(A, C, rtol)
    if S.shape[1]:
        inject = confining_gain(A, C, S)
        scale = spectral_norm(parts.C)  # what is left of C may be all rounding
        H = _left_null_rows(C @ S, rtol, scale)
        P = left_null_basis(S)[0]
    else:
        inject, H, P = np.zeros((len(A), len(C))), np.eye(len(C)), np.eye(len(A))
    n = len(A)
    F = without_rounding(P.T, np.hstack([np.eye(n), -G, -inject @ W]), np.vstack([parts.A, parts.C, parts.C]), P)
    inject, read = P.T @ (G + inject @ W), H @ W
    return Quotient(
        F,
        # bases are known to the rounding of their length: a residual must not read what that leaves of a state
        _without_rounding(without_rounding(H, C, P)),
        P.T @ parts.derivative,
        inject,
        read,
        P.T @ parts.process_noise - inject @ parts.measurement_noise,
        read @ parts.measurement_noise,
        direct,
    )


def _left_null_rows(M: NDArray, rtol: float, scale: float) -> NDArray[np.float64]:
    """Return rows of length one that annihilate a matrix; outputs that share nothing, as a dead one, are not mixed."""
    return rows_by_parts(M, lambda part: without_slight_mixing(left_null_basis(part, rtol=rtol, scale=scale)[0]))


@dataclass(frozen=True, eq=False)
class QuotientFilter:
    """The filter that a gain on the quotient makes, in the units of the plant.

    Attributes
    ----------
    system : StateSpace
        From the control inputs and outputs of the plant to ``read eta - C z``.
    state_map : ndarray
        ``T`` with ``z = T E x``.
    static_map : ndarray or None
        The algebraic equations that it reads; only for a plant with ``E``.
    """

    system: StateSpace
    state_map: NDArray
    static_map: NDArray | None


def quotient_filter(plant: Plant, parts: ExplicitParts, quotient: Quotient, gain: NDArray) -> QuotientFilter:
    """Return the filter of a gain on the quotient: ``z' = (A - gain C) z + (inject + gain read) eta``."""
    F = quotient.A - gain @ quotient.C
    # what rounding left of a dead sensor would be all of the dynamics that its fault has
    terms = np.abs(quotient.inject) + np.abs(gain) @ np.abs(quotient.read)
    K = above_rounding(quotient.inject + gain @ quotient.read, terms, RESIDUE)
    n_y = plant.n_outputs
    T = _without_rounding(quotient.T1 - K[:, n_y:] @ parts.algebra) * parts.equations
    read = _without_rounding(quotient.read)
    V = read[:, n_y:] @ parts.algebra * parts.equations
    used = _above_rounding(K[:, :n_y]) | _above_rounding(read[:, :n_y])
    Ky, Hy = K[:, :n_y] * parts.outputs * used, read[:, :n_y] * parts.outputs * used
    system = StateSpace(
        F,
        np.hstack([T @ plant.B - Ky @ plant.D, Ky]),
        -quotient.C,
        np.hstack([-V @ plant.B - Hy @ plant.D, Hy]),
        dt=plant.dt,
        inputs=signal_names(plant),
        outputs=[f"r{i + 1}" for i in range(len(Hy))],
    )
    return QuotientFilter(system, T, V if plant.E is not None else None)


def _without_rounding(M: NDArray) -> NDArray:
    """Return a matrix without the entries that are rounding against the largest of their row."""
    return above_rounding(M, np.abs(M).max(axis=1, keepdims=True, initial=0.0), RESIDUE)


def _above_rounding(M: NDArray) -> NDArray[np.bool_]:
    """Tell which columns are more than what rounding leaves of nothing: an output that is not used has none."""
    size = np.abs(M).max(axis=0, initial=0.0)
    return size > ROUNDING * size.max(initial=0.0)


def _unobservable(A: NDArray, C: NDArray, rtol: float) -> NDArray:
    """Return an orthonormal basis of the states that no output sees."""
    seen = reachable_basis(A.T, C.T, rtol=rtol)
    return left_null_basis(seen)[0] if seen.shape[1] else np.eye(len(A))
