"""One parity relation: polynomials in a basis that keeps their digits, in balanced units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from residua.design.core.generator import ResidualGenerator
from residua.design.core.internal_form import frequency_grid
from residua.design.parity.realization import pole_basis
from residua.errors import ModelError
from residua.linear.poles.placement import default_margin
from residua.linear.poles.pole_assignment import real_block_diagonal
from residua.linear.polynomials.pair_relations import PairRelations
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.plant import Plant
from residua.tolerances import TINY

#: Rad per sample, below which no residual of a sampled plant is looked at.
_SLOWEST = 1e-3
Matrix = NDArray[np.float64]
#: Poles that meet those of the plant are this part of the plant's distance from them apart.
_MEET = 1e-3
_NONE = np.zeros(0, dtype=np.complex128)


@dataclass(frozen=True, eq=False)
class Relation:
    r"""One relation: polynomials ``p``, ``q`` with :math:`p (zI - A) = q C` of the balanced plant.

    Attributes
    ----------
    equations : PairRelations
        All relations of its kind.
    p, q : ndarray, shape (order + 1, states) and (order + 1, outputs)
        Coefficients; the outputs include the algebraic equations.
    basis : PolynomialBasis
        In units of the rate of the plant.
    divided : ndarray
        Roots of the common factor that was divided out, in 1/s.
    """

    equations: PairRelations = field(repr=False)
    p: Matrix
    q: Matrix
    basis: PolynomialBasis
    divided: NDArray[np.complex128] = field(default_factory=_NONE.copy)

    @property
    def order(self) -> int:
        """The degree."""
        return len(self.q) - 1

    def times(self, factor: float) -> Relation:
        """Return a multiple."""
        return replace(self, p=factor * self.p, q=factor * self.q)

    def moved(self, basis: PolynomialBasis) -> Relation:
        """Return the same relation in another basis, made exact there."""
        p, q = self.equations.moved(self.p, self.q, self.basis, basis)
        return replace(self, p=p, q=q, basis=basis)

    def in_equations(self, plant: Plant) -> tuple[Matrix, Matrix]:
        """Return ``p`` and ``q`` with :math:`p (zE - A) = q C` of the balanced equations of the plant itself."""
        model, m = plant.balanced, plant.n_outputs
        return self.p @ model.derivative + self.q[:, m:] @ model.algebra, self.q[:, :m]


def lost_digits(rows: Sequence[Relation], generator: ResidualGenerator) -> float | None:
    """Return the digits of the data that cancel in residuals of faults, the faintest one; ``None`` without faults.

    In a filter on the poles of the rows' bases the terms are :math:`q_j N_j / N_k y`. What is left of them of the
    response to a fault, at frequencies below the rate of the plant (the median), is what rounding in data and
    arithmetic is relative to. A sampled plant that integrates answers to ever slower faults by ever more: frequencies
    begin at periods of 6,000 samples.
    """
    plant = generator.plant
    model = plant.balanced
    if not plant.faults:
        return None
    w = frequency_grid(generator.system, plant.system(()))
    w = w[w >= _SLOWEST / plant.dt] if plant.is_discrete else w
    w = w[w <= max(plant_rate(plant), w[len(w) // 4])]
    points = np.exp(1j * w * plant.dt) if plant.is_discrete else 1j * w / model.units.rate
    faults = np.abs(plant.system("fault").frequency_response(w))
    faults = faults * model.units.inputs[-len(plant.faults) :] * model.units.outputs[:, None]
    left = 1.0
    for row, seen in zip(rows, generator.structure, strict=True):
        N = row.basis.values(points, row.order) / row.basis.values(points, row.order)[:, -1:]
        response = np.abs(N @ (row.p @ model.faults[0] + row.q @ model.faults[1]))
        terms = np.einsum("wj,jm,wmf->wf", np.abs(N), np.abs(row.q[:, : plant.n_outputs]), faults)
        share = np.median(response / np.where(terms > 0, terms, 1.0), axis=0)
        left = min(left, float(share[seen].min(initial=1.0)))
    return float(-np.log10(max(left, TINY)))


def plant_rate(plant: Plant) -> float:
    """Return the rate in 1/s at which a continuous filter has its poles when the user lists none.

    The mean rate of the poles of the plant; where all of them integrate, the rate of the balanced plant.
    """
    rate = plant.balanced.units.rate
    try:
        A = plant.balanced.A if plant.E is None else real_block_diagonal(plant.system(()).poles() / rate)
    except ModelError:  # a singular plant may have no poles
        return 1.0
    return rate * default_margin(A, plant.dt)


def filter_basis(plant: Plant, poles: NDArray[np.complex128]) -> PolynomialBasis:
    """Return the basis on the poles of a filter, in 1/s, of the size of their distance from those of the plant."""
    model, at = plant.balanced, poles / plant.balanced.units.rate
    if not len(at) or not len(model.A) or (plant.is_discrete and not np.any(at)):  # a moving average stays one
        return pole_basis(at)
    apart = float(np.median(np.abs(np.linalg.eigvals(model.A)[:, None] - at)))
    least = _MEET * float(np.abs(model.A - at.real.mean() * np.eye(len(model.A))).max())
    return pole_basis(at, float(np.exp2(np.round(np.log2(max(apart, least) or 1.0)))))
