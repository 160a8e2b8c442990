"""All estimators of an uncertain loop that the nuisance faults do not reach: their fixed and their free numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.design.core.signals import signal_names
from residua.errors import DesignError
from residua.linear import StateSpace
from residua.linear.poles.observer_gain import cleared
from residua.plant import Plant
from residua.tolerances import RESPONSE_ROUNDING

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class EstimatorFamily:
    r"""The estimators of a loop with one residual each, decoupled from chosen faults whatever the free numbers are.

    .. math:: z_{k+1} = (A_q - Z C_q) z_k + (L + Z N) y_k, \qquad r_k = g^T (N y_k - C_q z_k)

    with :math:`z = T x` while nothing happens. Where the nuisance faults enter independent outputs, ``T`` is the
    identity and the gain :math:`W = L + Z N` solves :math:`W R_{2k} = R_{1k}`, the projection :math:`P = g^T N` solves
    :math:`P R_{2k} = 0`, for every nuisance ``k``: ``L`` is one solution, and the rows of ``N`` are all
    directions that they leave. Where they do not (faults of actuators), the part of the state that they reach is
    divided out.

    Attributes
    ----------
    plant : Plant
        The nominal loop.
    target : str
    decoupled : tuple of str
    A, C : ndarray
        ``A_q`` and ``C_q``, in balanced units.
    state_map : ndarray
        ``T`` with ``z = T x``, in the units of the plant.
    inject, read : ndarray
        ``L``, what every gain of the family has in common, and ``N``, for outputs in the units of the plant.
    """

    plant: Plant
    target: str
    decoupled: tuple[str, ...]
    A: Matrix
    C: Matrix
    state_map: Matrix
    inject: Matrix
    read: Matrix

    @property
    def order(self) -> int:
        """Number of states of the estimators."""
        return len(self.A)

    @property
    def rows(self) -> int:
        """Number of independent combinations of the outputs that are free of the nuisance faults."""
        return len(self.C)

    @property
    def full(self) -> bool:
        """True if the estimators are full-order observers: nothing had to be divided out."""
        return self.order == self.plant.n_states

    @property
    def size(self) -> int:
        """Number of free numbers: the gain, and the direction where there is a choice."""
        return self.order * self.rows + (self.rows if self.rows > 1 else 0)

    def split(self, points: Matrix) -> tuple[Matrix, Matrix]:
        """Return gains ``Z``, shape (k, order, rows), and unit directions ``g``, shape (k, rows), of points."""
        points = np.atleast_2d(points)
        count = self.order * self.rows
        Z = points[:, :count].reshape(len(points), self.order, self.rows)
        if self.rows == 1:
            return Z, np.ones((len(points), 1))
        g = points[:, count:]
        size = np.linalg.norm(g, axis=1, keepdims=True)
        first = np.eye(self.rows)[0]
        return Z, np.where(size > 0, g / np.where(size > 0, size, 1.0), first)

    def point(self, Z: Matrix, g: Matrix) -> Matrix:
        """Return the point that stands for a gain and a direction."""
        return np.concatenate([Z.ravel(), g]) if self.rows > 1 else Z.ravel()

    def estimator(self, point: Matrix, scale: float = 1.0) -> tuple[StateSpace, Matrix]:
        """Return the filter from the outputs to the residual, and its state map; those of the plant where full."""
        Z, g = (part[0] for part in self.split(point))
        p, T, W = self.plant, self.state_map, self.inject + Z @ self.read
        F, H, J = self.A - Z @ self.C, -scale * g[None] @ self.C, scale * g[None] @ self.read
        if self.full:  # from the plant itself, so that nothing but the rounding of W C is left between the two
            T, W = np.eye(self.order), np.linalg.solve(T, W)
            F, H = p.A - W @ p.C, -J @ p.C
        B, D = np.hstack([T @ p.B - W @ p.D, W]), np.hstack([-J @ p.D, J])
        states = p.states if self.full else None
        return StateSpace(F, B, H, D, dt=p.dt, inputs=signal_names(p), outputs=["r"], states=states), T


def estimator_family(plant: Plant, target: str, decoupled: tuple[str, ...]) -> EstimatorFamily:
    """Divide out the reach of nuisance faults; raises where no residual is left, or a lasting target leaves nothing."""
    model = plant.without_disturbances().faults_as_disturbances(decoupled).balanced
    q, units = model.quotient(), model.units
    O, (F, G) = q.split.seen, q.pair  # noqa: E741
    O = np.eye(len(F)) if O.shape == F.shape else O  # noqa: E741
    L, N = cleared(O.T @ q.J) * units.outputs, cleared(q.H) * units.outputs
    T = O.T @ q.N / units.states
    family = EstimatorFamily(plant, target, decoupled, O.T @ F @ O, G @ O, T, L, N)
    ignored, fewer = ", ".join(decoupled), "decouple fewer faults (decouple=) and give the others a size (sizes=)"
    if not family.rows:
        raise DesignError(
            f"no estimator for {target!r} ignores {ignored}: the {plant.n_outputs} outputs are all used up; {fewer}"
        )
    i, one = plant.faults.index(target), np.eye(plant.n_states)
    b, d = plant.Bf[:, i], plant.Df[:, i]
    # how the fault drives the error of all estimators, and what they read of it at once
    driven, direct = T @ b - L @ d, N @ d
    terms = np.concatenate([np.abs(N) @ np.abs(d), np.abs(T) @ np.abs(b) + np.abs(L) @ np.abs(d)]).max(initial=0.0)
    if not np.any(np.abs(np.concatenate([direct, driven])) > 1e-9 * terms):
        raise DesignError(
            f"a residual that ignores {ignored} cannot see {target!r}: they reach the outputs alike; {fewer}"
        )
    R = np.linalg.inv(one - plant.A)
    reached = np.abs(R) @ (one + (one + np.abs(plant.A)) @ np.abs(R)) @ np.abs(b)
    if not np.any(np.abs(plant.C @ R @ b + d) > RESPONSE_ROUNDING * (np.abs(plant.C) @ reached + np.abs(d))):
        raise DesignError(
            f"a lasting {target!r} leaves the outputs of the nominal loop as they are without it: their steady "
            "response to it is zero. Integral action does that: where the controller integrates, it moves the plant "
            "until all sensors read their set points again, and the command shows the fault (give the plant its "
            "control inputs as further outputs); where the plant itself integrates, nothing shows it: leave it out, "
            "faults="
        )
    # e' = A e + b - Z r with r = C e + d is at rest with r = 0, whatever Z, where that can be solved for e
    M, v = np.vstack([np.eye(family.order) - family.A, family.C]), np.concatenate([driven, -direct])
    e = np.linalg.lstsq(M, v, rcond=None)[0]
    if not np.any(np.abs(v - M @ e) > RESPONSE_ROUNDING * (np.abs(M) @ np.abs(e) + np.abs(v)).max(initial=0.0)):
        raise DesignError(
            f"no estimator that ignores {ignored or 'nothing'} sees {target!r} while it lasts: once they have settled, "
            f"the outputs answer to it as to what is ignored; {fewer}, or add a sensor (where the controller has "
            "integral action, the control inputs as further outputs)"
        )
    return family
