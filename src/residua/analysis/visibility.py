"""What the disturbances of a plant leave of each fault, at points where its pencil is evaluated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import ModelError
from residua.linear.balancing import state_units
from residua.linear.rank import decide_rank, equilibrated
from residua.plant import Plant


def generic_points(plant: Plant) -> NDArray[np.complex128]:
    """Return fixed points of the size of the plant's dynamics, off the axes, where a pole is unlikely."""
    poles = plant.system(()).poles()
    sizes = np.abs(poles)
    sizes = sizes[sizes > np.sqrt(np.finfo(float).eps) * sizes.max(initial=0.0)]  # a pole at zero is rounding
    size = float(np.exp(np.mean(np.log(sizes)))) if sizes.size else 1.0
    if plant.is_discrete:
        size = 1.0
    angles = np.array([0.731, 1.947, 2.653])
    return np.asarray(size * np.array([1.3170, 0.6931, 2.2360]) * np.exp(1j * angles), dtype=complex)


@dataclass(frozen=True, eq=False)
class Visible:
    """What the disturbances leave of each fault's column at some points.

    Attributes
    ----------
    columns : ndarray, shape (points, residual dimension, faults)
        Projections of the columns, scaled to unit length before.
    rank : int
        Normal rank of the pencil of the plant with its disturbances.
    rounding : ndarray, shape (points,)
        What rounding may have put into a projection.
    """

    columns: NDArray[np.complex128]
    rank: int
    rounding: NDArray[np.float64]


def in_balanced_units(plant: Plant) -> Plant:
    """Return the plant in units in which couplings and channels are comparable; what is visible stays so."""
    if plant.E is not None or plant.n_states == 0:
        return plant
    B = np.hstack([plant.Bd, plant.Bf])
    T = state_units(plant.A, B, plant.C)
    return plant._with(A=plant.A / T[:, None] * T, C=plant.C * T, Bd=plant.Bd / T[:, None], Bf=plant.Bf / T[:, None])


def visible_columns(plant: Plant, points: NDArray, rtol: float, rank: int | None = None) -> Visible:
    """Return what the disturbances leave of each fault at each point; ``rank`` overrides the decision."""
    n = plant.n_states
    E = np.eye(n) if plant.E is None else plant.E
    row = _row_units(plant, float(np.abs(generic_points(plant)).max()))
    Fd, Ff = np.vstack([plant.Bd, plant.Dd]) * row[:, None], np.vstack([plant.Bf, plant.Df]) * row[:, None]
    Fd = Fd / np.maximum(np.linalg.norm(Fd, axis=0), 1e-300)
    norms = np.linalg.norm(Ff, axis=0)
    spectra, left = [], []
    for s in points:
        pencil = np.hstack([np.vstack([plant.A - s * E, plant.C]) * row[:, None], Fd])
        scale = np.maximum(np.linalg.norm(pencil, axis=0), 1e-300)
        U, values, _ = np.linalg.svd(pencil / scale)
        spectra.append(values)
        left.append(U)
    if rank is None:
        rank = max((int(np.count_nonzero(v > rtol * v[0])) for v in spectra if v.size), default=0)
    smallest = np.array([v[rank - 1] / v[0] if rank else 1.0 for v in spectra])
    # the bound is pessimistic where the pencil is nearly singular for reasons that no fault shares
    rounding = np.minimum(1e3 * np.finfo(float).eps / np.maximum(smallest, 1e-300), 1e-6)
    columns = np.stack([U[:, rank:].conj().T @ (Ff / norms) for U in left])
    return Visible(columns, rank, rounding)


def _row_units(plant: Plant, size: float) -> NDArray[np.float64]:
    """Return factors for the rows of the pencil that make its entries comparable, whatever the units."""
    E = np.eye(plant.n_states) if plant.E is None else plant.E
    top = np.hstack([size * np.abs(E) + np.abs(plant.A), np.abs(plant.Bd), np.abs(plant.Bf)])
    M = np.vstack([top, np.abs(np.hstack([plant.C, plant.Dd, plant.Df]))])
    row = np.ones(len(M))
    for _ in range(10):
        height = np.sqrt(M.max(axis=1, initial=0.0))
        height = np.where(height > 0, height, 1.0)
        width = np.sqrt(M.max(axis=0, initial=0.0))
        M = M / height[:, None] / np.where(width > 0, width, 1.0)
        row /= height
    return row


def check_regular(plant: Plant, points: NDArray) -> None:
    """Raise when det(sE - A) vanishes for every s."""
    if plant.E is None or plant.n_states == 0:
        return
    ranks = [decide_rank(equilibrated(s * plant.E - plant.A, residue=0.0), rtol=1e-13).rank for s in points]
    if max(ranks) < plant.n_states:
        raise ModelError("det(sE - A) is zero for every s: the model is not a plant (check E and A)")
