"""What the disturbances of a plant leave of each fault, at points where its pencil is evaluated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import ModelError
from residua.linear.subspaces.rank import decide_rank, equilibrated
from residua.linear.systems.balancing import evened
from residua.linear.systems.units import bordered
from residua.plant import Plant
from residua.plant.comparable_units import canonical_units, in_unit_of_rates
from residua.tolerances import TINY

#: Vectors of unit length that begin with less than this begin with nothing.
_NOTHING = 1e-6


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


def in_canonical_units(plant: Plant) -> Plant:
    """Return the plant in units that are the same whatever units it was written in, that of time too.

    What is visible stays so.
    """
    plant, _ = in_unit_of_rates(plant)
    return canonical_units(plant, controls=False).applied(plant)


def visible_columns(plant: Plant, points: NDArray, rtol: float, rank: int | None = None) -> Visible:
    """Return what the disturbances leave of each fault at each point; ``rank`` overrides the decision."""
    parts = _parts(plant, _row_units(plant))
    spectra, left = [], []
    for s in points:
        U, values = _left_vectors(parts.at(s))
        spectra.append(values)
        left.append(U)
    if rank is None:
        rank = max((int(np.count_nonzero(v > rtol * v[0])) for v in spectra if v.size), default=0)
    smallest = np.array([v[rank - 1] / v[0] if rank else 1.0 for v in spectra])
    columns = np.stack([U[:, rank:].conj().T @ parts.faults for U in left])
    return Visible(columns, rank, _rounding(smallest))


def limit_columns(plant: Plant, rtol: float, rank: int) -> Visible:
    """Return what the disturbances leave of each constant fault in the end, as at one point: at ``s = 0`` (``z = 1``).

    A zero of the plant there makes the null space of the pencil larger at that point. Those of its vectors count that
    annihilate the pencil around the point too: that begin a series ``x0 + x1 s + ...`` with ``x (P0 + s P1) = 0`` up to
    any power of ``s``. Powers are added until as many are left as there are elsewhere, which ``rank`` tells.
    """
    parts = _parts(plant, _row_units_in_the_limit(plant))
    here = parts.at(_limit_point(plant))
    along = np.zeros_like(here)
    along[: plant.n_states, : plant.n_states] = -_size(plant) * parts.dynamic
    scale = np.maximum(np.linalg.norm(here, axis=0), np.linalg.norm(along, axis=0))
    here, along = (M / np.where(scale > 0, scale, 1.0) for M in (here, along))
    wanted = len(here) - rank
    first, smallest = np.zeros((wanted, len(here))), 1.0
    for count in range(1, plant.n_states + 2):
        T = _series_matrix(here, along, count)
        U, values = _left_vectors(T)
        kept = int(np.count_nonzero(values > rtol * values[0])) if values.size else 0
        _, sizes, Vh = np.linalg.svd(U[:, kept:].T[:, : len(here)], full_matrices=False)
        first = Vh[:wanted]
        smallest = (values[kept - 1] / values[0] if kept else 1.0) * float(sizes[:wanted].min(initial=1.0))
        if not np.any(sizes[wanted:] > _NOTHING):
            break
    columns = (first @ parts.faults)[None].astype(np.complex128)
    return Visible(columns, rank, _rounding(np.array([smallest])))


def _series_matrix(here: NDArray, along: NDArray, count: int) -> NDArray[np.float64]:
    """Return the matrix of the first coefficients of ``(x0 + x1 s + ...) (here + s along)``."""
    rows, columns = here.shape
    T = np.zeros((count, rows, count, columns))
    for k in range(count):
        T[k, :, k] = here
        if k + 1 < count:
            T[k, :, k + 1] = along
    return T.reshape(count * rows, count * columns)


def _left_vectors(M: NDArray) -> tuple[NDArray, NDArray[np.float64]]:
    """Return left singular vectors and singular values of a matrix with columns of one length."""
    size = np.linalg.norm(M, axis=0)
    U, values, _ = np.linalg.svd(M / np.where(size > 0, size, 1.0))
    return U, values


def _rounding(smallest: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what rounding may have put into a projection; too much where the pencil is nearly singular for all."""
    return np.minimum(1e3 * np.finfo(float).eps / np.maximum(smallest, TINY), 1e-6)


@dataclass(frozen=True, eq=False)
class _Parts:
    """The pencil of a plant, its rows in units in which they are comparable, with columns of unit length.

    Attributes
    ----------
    static, dynamic : ndarray
        ``[A; C]`` and ``E``.
    disturbances, faults : ndarray
    """

    static: NDArray[np.float64]
    dynamic: NDArray[np.float64]
    disturbances: NDArray[np.float64]
    faults: NDArray[np.float64]

    def at(self, s: complex) -> NDArray:
        """Return the pencil with the columns of the disturbances at a point."""
        states = self.static + 0 * s
        states[: len(self.dynamic)] -= s * self.dynamic
        return np.hstack([states, self.disturbances])


def _dynamic(plant: Plant) -> NDArray[np.float64]:
    return np.eye(plant.n_states) if plant.E is None else plant.E


def _size(plant: Plant) -> float:
    """Return the size of ``s`` where the dynamics of the plant are."""
    return float(np.abs(generic_points(plant)).max())


def _limit_point(plant: Plant) -> float:
    return 1.0 if plant.is_discrete else 0.0


def _parts(plant: Plant, row_units: NDArray) -> _Parts:
    row = row_units[:, None]
    Fd, Ff = (row * np.vstack([B, D]) for B, D in ((plant.Bd, plant.Dd), (plant.Bf, plant.Df)))
    Fd, Ff = (F / np.maximum(np.linalg.norm(F, axis=0), TINY) for F in (Fd, Ff))
    return _Parts(row * np.vstack([plant.A, plant.C]), row[: plant.n_states] * _dynamic(plant), Fd, Ff)


def _row_units(plant: Plant) -> NDArray[np.float64]:
    """Return factors for the rows of the pencil that make its entries comparable, whatever the units."""
    top = np.hstack([_size(plant) * np.abs(_dynamic(plant)) + np.abs(plant.A), np.abs(plant.Bd), np.abs(plant.Bf)])
    M = np.vstack([top, np.abs(np.hstack([plant.C, plant.Dd, plant.Df]))])
    row = np.ones(len(M))
    for _ in range(10):
        height = np.sqrt(M.max(axis=1, initial=0.0))
        height = np.where(height > 0, height, 1.0)
        width = np.sqrt(M.max(axis=0, initial=0.0))
        M = M / height[:, None] / np.where(width > 0, width, 1.0)
        row /= height
    return row


def _row_units_in_the_limit(plant: Plant) -> NDArray[np.float64]:
    """Return the same at ``s = 0`` (``z = 1``), where ``E`` takes part only in rows and columns that have nothing else.

    From least squares on: a state that one sensor alone reads, and that sensor, could have any unit there if only the
    largest entries of rows and columns had to be one.
    """
    E = _dynamic(plant)
    here = np.abs(plant.A - _limit_point(plant) * E)
    silent = np.logical_or.outer(~np.any(here, axis=1), ~np.any(np.vstack([here, plant.C]), axis=0))
    inputs, through = np.hstack([plant.Bd, plant.Bf]), np.hstack([plant.Dd, plant.Df])
    return evened(bordered(here + np.where(silent, _size(plant) * np.abs(E), 0.0), inputs, plant.C, through))[0]


def check_regular(plant: Plant, points: NDArray) -> None:
    """Raise when det(sE - A) vanishes for every s."""
    if plant.E is None or plant.n_states == 0:
        return
    ranks = [decide_rank(equilibrated(s * plant.E - plant.A, residue=0.0), rtol=1e-13).rank for s in points]
    if max(ranks) < plant.n_states:
        raise ModelError("det(sE - A) is zero for every s: the model is not a plant (check E and A)")
