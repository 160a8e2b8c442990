"""A plant, or an input-output model, as the equations that parity relations are combined from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from residua import arrays
from residua.design.core.evidence import format_pole
from residua.errors import ModelError
from residua.linear.polynomials.pencil_null_space import Pencil, pencil
from residua.linear.polynomials.polynomial_basis import PolynomialBasis, basis_on_poles
from residua.linear.systems.array_cache import cached_by_contents, copied
from residua.plant import Plant
from residua.plant.comparable_units import PlantUnits, canonical_units, even_plant
from residua.plant.input_output_model import InputOutputModel
from residua.tolerances import RESIDUE, above_rounding

#: Poles below this fraction of the size of the plant's dynamics are zero.
_ZERO = 1e-10
#: A pole of as many times as there are states is scattered by the root of so many roundings.
_SCATTER = 4
#: States up to which one pole of all of them can be separated from others: 2**-52 to the power of 1/7 is 0.006.
_MOST_OF_ONE_POLE = 7


@dataclass(frozen=True, eq=False)
class RelationModel:
    r"""The equations of a plant, :math:`[zE - A;\, -C]\, x = [B;\, 0] u + \dots - [0;\, I] y`.

    A relation is a combination ``x(z) = [p(z), q(z)]`` of their rows with ``x [zE - A; -C] = 0``: it says
    :math:`q y - (p B + q D) u = (p B_f + q D_f) f + (p B_d + q D_d) d`.

    Attributes
    ----------
    plant : Plant
    excluded : ndarray, shape (rows, columns)
        Constant columns that must be annihilated besides: outputs that may not be read.
    basis : PolynomialBasis
        In which polynomials are written: on the poles of the plant.
    most : int
        No relation of a shortest set is longer.
    notes : tuple of str
        The changes to the model before.
    decouples : bool
        Whether relations ignore the disturbances.
    """

    plant: Plant
    excluded: NDArray[np.float64] = field(repr=False)
    basis: PolynomialBasis = field(repr=False)
    most: int
    notes: tuple[str, ...] = ()
    decouples: bool = True

    def in_own_units(self) -> tuple[RelationModel, PlantUnits]:
        """Return the equations in units that are the same whatever units the plant was written in, and these."""
        units = replace(canonical_units(self.plant), noise=1.0)  # which may count beside disturbances of expected sizes
        plant = units.applied(self.plant)
        basis = basis_for(plant, self.basis.count)
        height = np.concatenate([units.equations, units.outputs])[:, None]
        excluded = self.excluded * height
        size = np.abs(excluded).max(axis=0, initial=0.0)
        return replace(self, plant=plant, basis=basis, excluded=excluded / np.where(size > 0, size, 1.0)), units

    @property
    def faults(self) -> NDArray[np.float64]:
        """What the faults add to the equations, shape (states + outputs, faults)."""
        return np.vstack([self.plant.Bf, self.plant.Df])

    def ignored_columns(self, ignored: Sequence[str | int]) -> NDArray[np.float64]:
        """Return the constant columns that a relation annihilates which ignores some faults and all disturbances."""
        chosen = arrays.positions(ignored, self.plant.faults, "fault")
        disturbances = np.vstack([self.plant.Bd, self.plant.Dd])[:, : None if self.decouples else 0]
        return np.hstack([self.excluded, disturbances, self.faults[:, chosen]])

    def reading(self, outputs: Iterable[str | int] | str | None) -> RelationModel:
        """Return the model of relations that read some of the outputs only."""
        if outputs is None:
            return self
        chosen = arrays.different_positions(outputs, self.plant.outputs, "output")
        n = self.plant.n_states
        others = [n + i for i in range(self.plant.n_outputs) if i not in chosen]
        return replace(self, excluded=np.hstack([self.excluded, np.eye(n + self.plant.n_outputs)[:, others]]))


def relation_model(source: Plant | InputOutputModel) -> RelationModel:
    """Return the equations of a plant, or of the minimal state-space form of an input-output model.

    Raises
    ------
    ModelError
        If it is neither.
    """
    notes: tuple[str, ...] = ()
    if isinstance(source, InputOutputModel):
        realized = source.realization()
        if len(realized.removed_modes):
            roots = ", ".join(map(format_pole, realized.removed_modes))
            notes = (f"the equations of the model share factors without effect, which were divided out: roots {roots}",)
        source = realized.plant
    if not isinstance(source, Plant):
        raise ModelError(f"parity relations are made from a Plant or an InputOutputModel, got {type(source).__name__}")
    n = source.n_states
    return RelationModel(source, np.zeros((n + source.n_outputs, 0)), basis_for(source, n + 1), n, notes)


def state_pencil(
    plant: Plant, columns: NDArray[np.float64], basis: PolynomialBasis, *, canonical: bool = False
) -> Pencil:
    """Return ``[zE - A; -C]`` with further constant columns; ``canonical``: of a plant in units of its own."""
    n, m = plant.n_states, plant.n_outputs
    E = np.eye(n) if plant.E is None else plant.E
    P0 = np.hstack([np.vstack([-plant.A, -plant.C]), columns])
    P1 = np.hstack([np.vstack([E, np.zeros((m, n))]), np.zeros((n + m, columns.shape[1]))])
    return pencil(P0, P1, basis, canonical=canonical)


def basis_for(plant: Plant, count: int) -> PolynomialBasis:
    """Return the basis on the poles of a plant, each used as often as needed for a number of nodes.

    Sizes are those of even units: the entries of a chain of integrators have none but those of its states.
    """
    return copied(_kept_basis(plant, count))  # which relations hold


@cached_by_contents
def _kept_basis(plant: Plant, count: int) -> PolynomialBasis:
    plant = even_plant(plant).plant
    try:
        poles = plant.system(()).poles()
    except ModelError:  # the pencil of a singular plant need not be regular
        poles = np.zeros(0, dtype=np.complex128)
    E = np.eye(plant.n_states) if plant.E is None else plant.E
    level = 1.0 if plant.is_discrete else _mean_size(plant.A) / _mean_size(E)
    poles = np.where(np.abs(poles) > _ZERO * level, poles, 0j).astype(
        np.complex128
    )  # a size that is rounding would take equations for zero
    finite = np.abs(poles[np.isfinite(poles)])
    size = (float(np.median(finite)) if finite.size else 0.0) or level
    if plant.E is None and 1 < plant.n_states <= _MOST_OF_ONE_POLE:
        a = float(np.trace(plant.A)) / plant.n_states
        rest = above_rounding(plant.A - a * np.eye(plant.n_states), float(np.abs(plant.A).max()), RESIDUE)
        scatter = float(np.linalg.norm(rest)) * (_SCATTER * np.finfo(float).eps) ** (1 / plant.n_states)
        if np.abs(poles - a).max() <= scatter:  # one pole, as far as rounding lets one tell
            return basis_on_poles(np.full(len(poles), a), count, _mean_size(rest), outward=True)
    return basis_on_poles(poles, count, size, outward=True)


def _mean_size(M: NDArray[np.float64]) -> float:
    """Return the geometric mean of the entries that are not zero."""
    sizes = np.abs(M[M != 0])
    return float(np.exp(np.mean(np.log(sizes)))) if sizes.size else 1.0
