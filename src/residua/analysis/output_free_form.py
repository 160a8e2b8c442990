"""A plant without disturbances in its outputs, and one with its algebraic equations as outputs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.arrays import frozen
from residua.linear.subspaces.rank import (
    DEFAULT_RTOL,
    RankDecision,
    decide_rank,
    left_null_basis,
    spectral_norm,
    without_noise,
)
from residua.linear.systems.scaling import even_units, scaling
from residua.plant import OperatingPoint, Plant
from residua.plant.disturbances import factor_disturbance
from residua.tolerances import RESIDUE, TINY, above_rounding, without_rounding


@dataclass(frozen=True, eq=False)
class OutputFreeForm:
    r"""The plant rewritten so that no disturbance enters the outputs that are used.

    With :math:`D_d = U_1 S V_1^T`, the part of ``d`` that reaches the outputs is expressed by them,
    :math:`V_1^T d = S^{-1} U_1^T (y - C x)`, and put into the state equation; the outputs :math:`W y`
    with :math:`W D_d = 0` remain.

    Attributes
    ----------
    A, C, E : ndarray
        Of :math:`\dot x = A x + G y + \dots + E d`, :math:`W y = C x`; ``E`` has full column rank.
    G : ndarray, shape (n, outputs)
    W : ndarray, shape (outputs left, outputs)
    rank_E : RankDecision
    """

    A: NDArray
    C: NDArray
    E: NDArray
    G: NDArray
    W: NDArray
    rank_E: RankDecision


def output_free_form(plant: Plant, *, rtol: float = DEFAULT_RTOL) -> OutputFreeForm:
    """Return the plant with the disturbances removed from its outputs; see :class:`OutputFreeForm`."""
    p, n = plant.n_outputs, plant.n_states
    if not np.any(plant.Dd):
        E1, decision = factor_disturbance(plant.Bd, rtol=rtol)
        E = plant.Bd if decision.rank == plant.Bd.shape[1] else E1
        return OutputFreeForm(plant.A, plant.C, E, np.zeros((n, p)), np.eye(p), decision)
    rows, columns = _units(np.vstack([plant.Bd, plant.Dd]), plant.n_states)
    Bd, Dd = plant.Bd * columns, rows[:, None] * plant.Dd * columns
    live = np.any(plant.C, axis=1) | np.any(Dd, axis=1)  # a dead output stays by itself: no combination reads it
    U, s, Vh = np.linalg.svd(Dd[live])
    U, Vh = without_noise(U), without_noise(Vh)  # no residual reads an output through what rounding left there
    r = int(np.count_nonzero(s > rtol * s[0]))
    whole = np.eye(p)
    G = without_rounding(Bd, Vh[:r].T / s[:r], U[:, :r].T, whole[live]) * rows
    W = without_noise(np.linalg.qr((U[:, r:].T * rows[live]).T)[0].T)
    W = np.vstack([W @ whole[live], whole[~live]])
    rest = without_rounding(Bd, Vh[r:].T)
    scale = spectral_norm(Bd)
    E, decision = factor_disturbance(rest, rtol=rtol)
    if scale and decision.singular_values.size and decision.singular_values[0] <= rtol * scale:
        E, decision = rest[:, :0], RankDecision(0, decision.singular_values, rtol * scale)
    A = without_rounding(np.hstack([np.eye(n), -G]), np.vstack([plant.A, plant.C]))
    return OutputFreeForm(A, without_rounding(W, plant.C), E, G, W, decision)


def _units(F: NDArray, n_states: int) -> tuple[NDArray, NDArray]:
    """Return factors for the outputs and for the disturbances that make their entries comparable."""
    columns = 1.0 / np.maximum(np.abs(F).max(axis=0, initial=0.0), TINY)
    heights = np.abs(F[n_states:] * columns).max(axis=1, initial=0.0)
    rows = 1.0 / np.where(heights > 0, heights, 1.0)
    columns = 1.0 / np.maximum(np.abs(rows[:, None] * F[n_states:]).max(axis=0, initial=0.0), TINY)
    silent = ~np.any(F[n_states:], axis=0)
    return rows, np.where(silent, 1.0 / np.maximum(np.abs(F).max(axis=0, initial=0.0), TINY), columns)


def is_singular(plant: Plant) -> bool:
    """Tell whether ``E`` of a plant is singular."""
    if plant.E is None:
        return False
    rows, columns = even_units(plant.E)
    return decide_rank(rows[:, None] * plant.E * columns, rtol=1e-12).rank < plant.n_states


@dataclass(frozen=True, eq=False)
class Decoupling:
    """All solutions of ``T E + H C = I``, ``T E_d = 0`` for a singular plant, on outputs without disturbances.

    They are ``T - Z N``, ``H - Z M`` with any ``Z``, so that ``T A`` may be changed by ``Z N A``: for pole placement
    ``N A`` are further measurements. The algebraic equations are among them.

    Attributes
    ----------
    T : ndarray, shape (n, n)
    H : ndarray, shape (n, outputs left)
    N, M : ndarray, shapes (k, n) and (k, outputs left)
        ``N E + M C = 0``, ``N E_d = 0``, dead outputs left out.
    rank, rank_D : RankDecision
        Of ``[E E_d; C 0]`` and of ``E_d``.
    """

    T: NDArray
    H: NDArray
    N: NDArray
    M: NDArray
    rank: RankDecision
    rank_D: RankDecision


def singular_decoupling(plant: Plant, form: OutputFreeForm, *, rtol: float = DEFAULT_RTOL) -> Decoupling:
    r"""Return the smallest :math:`[T\ H]` with :math:`[T\ H] [E\ E_d; C\ 0] = [I\ 0]`, in balanced units.

    It solves the equations only where ``rank`` is ``n`` more than ``rank_D``.
    """
    n, q, p = plant.n_states, form.E.shape[1], len(form.C)
    E = np.eye(n) if plant.E is None else plant.E
    B, D = np.hstack([plant.B, form.E]), np.zeros((p, len(plant.inputs) + q))
    u = scaling(form.A, B, form.C, D, E, sampled=plant.is_discrete)
    R, S, Y = u.equations[:, None], u.states, u.outputs[:, None]
    D = R * form.E
    size = np.linalg.norm(D, axis=0)
    D = D / np.where(size > 0, size, 1.0)
    whole = np.block([[R * E * S, D], [Y * form.C * S, np.zeros((p, q))]])
    level = np.linalg.norm(whole[:, :n], axis=0)  # time has units too: E may be small against C
    whole[:, :n] /= np.where(level > 0, level, 1.0)
    inverse = np.linalg.pinv(whole, rcond=rtol)[:n]
    inverse = above_rounding(inverse, np.abs(inverse).max(initial=0.0), RESIDUE)  # rounding is no coupling
    inverse = inverse / np.where(level > 0, level, 1.0)[:, None]
    read = np.append(np.ones(n, dtype=bool), np.any(form.C, axis=1))  # a dead output gets no gain
    inverse = np.where(read, inverse, 0.0)
    T, H = S[:, None] * inverse[:, :n] * u.equations, S[:, None] * inverse[:, n:] * u.outputs
    free = left_null_basis(whole[read], rtol=rtol, scale=1.0)[0].T @ np.eye(n + p)[read]
    N, M = free[:, :n] * u.equations, free[:, n:] * u.outputs
    return Decoupling(T, H, N, M, decide_rank(whole, rtol=rtol, scale=1.0), decide_rank(D, rtol=rtol, scale=1.0))


def decoupling_map(H: NDArray, C: NDArray) -> NDArray[np.float64]:
    """Return ``T = I - H C`` of an ordinary plant, exactly zero where only rounding is left."""
    whole = np.eye(len(H))
    return without_rounding(np.hstack([whole, -H]), np.vstack([whole, C]))


def error_pair(decoupling: Decoupling, form: OutputFreeForm) -> tuple[NDArray, NDArray]:
    """Return the pair whose poles are placed: ``T A`` and the measurements ``[C; N A]``."""
    return without_rounding(decoupling.T, form.A), np.vstack([form.C, without_rounding(decoupling.N, form.A)])


def algebraic_equations(plant: Plant, *, without: NDArray | None = None) -> NDArray[np.float64]:
    """Return a basis, of unit size, of the combinations ``N`` of a plant's equations without derivatives, ``N E = 0``.

    Only of those that no disturbance enters by the columns of ``without``, if there are any.
    """
    if plant.E is None:
        return np.zeros((0, plant.n_states))
    drive, direct = np.hstack([plant.B, plant.Bd]), np.hstack([plant.D, plant.Dd])
    u = scaling(plant.A, drive, plant.C, direct, plant.E, sampled=plant.is_discrete)
    E = u.equations[:, None] * plant.E * u.states
    D = u.equations[:, None] * (plant.Bd[:, :0] if without is None else without)
    size = np.linalg.norm(D, axis=0)
    D = D / np.where(size > 0, size, 1.0)
    N = left_null_basis(np.hstack([E / (np.linalg.norm(E) or 1.0), D]))[0].T
    N = above_rounding(N, 1.0, RESIDUE) * u.equations
    return N / np.maximum(np.abs(N).max(axis=1, keepdims=True, initial=0.0), TINY)


def with_equations_measured(plant: Plant) -> tuple[Plant, NDArray[np.float64]]:
    """Return a singular plant with its algebraic equations as further outputs, which read zero, and these equations.

    ``N (A x + B u + E_d d) = 0`` with ``N E = 0`` tells of the state what a sensor would. A disturbance that enters one
    by rounding only would have units in which that is all of it.
    """
    N = algebraic_equations(plant)
    measured = plant._with(
        C=frozen(np.vstack([plant.C, without_rounding(N, plant.A)])),
        outputs=(*plant.outputs, *(f"equation {i + 1}" for i in range(len(N)))),
        operating_point=OperatingPoint(
            plant.operating_point.inputs, (*plant.operating_point.outputs, *(0.0,) * len(N))
        ),
        **{
            f"D{role}": frozen(np.vstack([getattr(plant, f"D{role}"), without_rounding(N, getattr(plant, f"B{role}"))]))
            for role in "udfw"
        },
    )
    return measured, N
