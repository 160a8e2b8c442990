"""A plant, or an input-output model, as the balanced equations that parity relations are combined from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua import arrays
from residua.design.core.evidence import format_pole
from residua.errors import ModelError
from residua.linear.polynomials.pair_relations import PairRelations
from residua.plant import Plant
from residua.plant.balanced import BalancedPlant
from residua.plant.input_output_model import InputOutputModel
from residua.tolerances import BALANCED_RANK

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RelationModel:
    r"""The balanced equations of a plant, :math:`\dot\xi = A \xi + B v, \; y = C \xi + D v`.

    A relation is a pair of polynomial rows with :math:`p (zI - A) = q C`: it says
    :math:`q y - (p B + q D) u = (p B_f + q D_f) f + (p B_d + q D_d) d`.

    Attributes
    ----------
    plant : Plant
    unread : tuple of int
        Outputs that may not be read.
    notes : tuple of str
        The changes to the model before.
    decouples : bool
        Whether relations ignore the disturbances.
    """

    plant: Plant
    unread: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()
    decouples: bool = True

    @property
    def balanced(self) -> BalancedPlant:
        """The plant in balanced units."""
        return self.plant.balanced

    def unknown(self, ignored: Sequence[str | int] = ()) -> tuple[Matrix, Matrix]:
        """Return ``B`` and ``D`` of all that relations do not see which ignore some faults."""
        model = self.balanced
        B, D = model.unknown(arrays.positions(ignored, self.plant.faults, "fault"))
        if not self.decouples:
            kept = np.r_[: model.free[0].shape[1], model.free[0].shape[1] + len(self.plant.disturbances) : B.shape[1]]
            B, D = B[:, kept], D[:, kept]
        unread = np.eye(len(D))[:, list(self.unread)]
        return np.hstack([B, np.zeros((len(B), unread.shape[1]))]), np.hstack([D, unread])

    def equations(self, ignored: Sequence[str | int] = (), *, tolerance: float = BALANCED_RANK) -> PairRelations:
        """Return the relations that ignore some faults."""
        B, D = self.unknown(ignored)
        return PairRelations.of(self.balanced.A, B, self.balanced.C, D, tolerance=tolerance)

    def reading(self, outputs: Iterable[str | int] | str | None) -> RelationModel:
        """Return the model of relations that read some of the outputs only."""
        if outputs is None:
            return self
        chosen = arrays.different_positions(outputs, self.plant.outputs, "output")
        return replace(self, unread=tuple(i for i in range(self.plant.n_outputs) if i not in chosen))


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
    return RelationModel(source, notes=notes)
