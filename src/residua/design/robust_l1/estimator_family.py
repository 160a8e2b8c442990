"""All estimators of an uncertain loop that the nuisance faults do not reach: what is fixed, and what is free."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from residua.design.banks.unknown_input_quotient import (
    ExplicitParts,
    Quotient,
    explicit_parts,
    quotient_filter,
    unknown_input_quotient,
)
from residua.errors import DesignError
from residua.linear import StateSpace
from residua.linear.rank import DEFAULT_RTOL
from residua.plant import Plant

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
    parts : ExplicitParts
    quotient : Quotient
        ``A_q``, ``C_q``, ``L`` (``inject``) and ``N`` (``read``), in balanced units.
    """

    plant: Plant
    target: str
    decoupled: tuple[str, ...]
    parts: ExplicitParts
    quotient: Quotient

    @property
    def order(self) -> int:
        """Number of states of the estimators."""
        return len(self.quotient.A)

    @property
    def rows(self) -> int:
        """How many independent combinations of the outputs are free of the nuisance faults."""
        return len(self.quotient.C)

    @property
    def full(self) -> bool:
        """Whether the estimators are full-order observers: nothing had to be divided out."""
        return self.order == self.plant.n_states

    @property
    def size(self) -> int:
        """How many numbers are free: the gain, and the direction where there is a choice."""
        return self.order * self.rows + (self.rows if self.rows > 1 else 0)

    @cached_property
    def state_map(self) -> Matrix:
        """``T`` with ``z = T x``, in the units of the plant."""
        return self.quotient.T1 * self.parts.equations

    @cached_property
    def inject(self) -> Matrix:
        """``L``: what every gain of the family has in common, for outputs in the units of the plant."""
        return self.quotient.inject * self.parts.outputs

    @cached_property
    def read(self) -> Matrix:
        """``N``, for outputs in the units of the plant."""
        return self.quotient.read * self.parts.outputs

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
        made = quotient_filter(self.plant, self.parts, self.quotient, Z)
        s, T = made.system, made.state_map
        H, J = scale * g[None] @ s.C, scale * g[None] @ s.D
        if not self.full:
            return s.replaced(C=H, D=J, outputs=["r"]), T
        back = np.linalg.inv(T)
        one = StateSpace(
            back @ s.A @ T, back @ s.B, H @ T, J, dt=s.dt, states=self.plant.states, inputs=s.inputs, outputs=["r"]
        )
        return one, np.eye(self.order)


def estimator_family(
    plant: Plant, target: str, decoupled: tuple[str, ...], *, rtol: float = DEFAULT_RTOL
) -> EstimatorFamily:
    """Divide out what nuisance faults reach; raises where no residual is left, or the target is lost with them."""
    aim = plant.without_disturbances().faults_as_disturbances(decoupled)
    parts = explicit_parts(aim)
    quotient = unknown_input_quotient(parts, rtol)
    family = EstimatorFamily(plant, target, decoupled, parts, quotient)
    if not family.rows:
        raise DesignError(
            f"no estimator for {target!r} ignores {', '.join(decoupled)}: the {plant.n_outputs} outputs are all used "
            "up; decouple fewer faults (decouple=) and give the others a size (sizes=)"
        )
    i = plant.faults.index(target)
    direct, driven = family.read @ plant.Df[:, i], family.state_map @ plant.Bf[:, i] - family.inject @ plant.Df[:, i]
    size = np.abs(family.read) @ np.abs(plant.Df[:, i])
    moved = np.abs(family.state_map) @ np.abs(plant.Bf[:, i]) + np.abs(family.inject) @ np.abs(plant.Df[:, i])
    terms = np.concatenate([size, moved]).max(initial=0.0)
    if not np.any(np.abs(np.concatenate([direct, driven])) > 1e-9 * terms):
        raise DesignError(
            f"a residual that ignores {', '.join(decoupled)} cannot see {target!r}: they reach the outputs alike; "
            "decouple fewer faults (decouple=) and give the others a size (sizes=)"
        )
    return family
