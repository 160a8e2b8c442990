"""What a full-order observer has to ignore: columns of its error equation, taken out of the outputs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua import arrays
from residua.design.detection_filters.directional_gain import unstable
from residua.design.observers.unknown_input_observer import ErrorPair, error_pair
from residua.errors import DesignError
from residua.linear.poles.spectrum import describe_modes
from residua.linear.subspaces.rank import RankDecision, decide_rank
from residua.plant import Plant
from residua.plant.balanced import is_singular
from residua.tolerances import BALANCED_RANK, above_rounding

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class IgnoredColumns:
    r"""The error pair of a plant whose ignored inputs have been taken out of the outputs that are used.

    A sensor whose fault is to be ignored is not used: no gain on ``W y`` reads it.

    Attributes
    ----------
    pair : ErrorPair
        With white noise; :math:`T = I`.
    columns : dict of str to ndarray, shape (n, 1)
        Directions left to be ignored in the state equation: unit vectors, one for each ignored input that has such.
    names : tuple of str
        Everything that is to be ignored: the disturbances, then the faults named.
    direct : RankDecision
        Rank of the ignored inputs in the outputs.
    """

    pair: ErrorPair
    columns: dict[str, Matrix]
    names: tuple[str, ...]
    direct: RankDecision

    @property
    def text(self) -> str:
        """The names in words."""
        return ", ".join(f"'{name}'" for name in self.names) or "nothing"

    @property
    def stacked(self) -> Matrix:
        """The columns side by side."""
        return np.hstack([np.zeros((len(self.pair.A), 0)), *self.columns.values()])

    def rows(self, S: Matrix) -> Matrix:
        """Return rows on the outputs of the plant that span what rows on those of the pair do.

        Each has an output of its own and length one, the first entry positive.
        """
        even, pivots = S @ self.pair.outputs @ self.pair.W, []
        for i in range(len(S)):
            size = np.linalg.norm(even[i:], axis=0)
            pivots.append(j := int(np.argmax(size > 0.9 * size.max())))
            k = i + int(np.argmax(np.abs(even[i:, j])))
            even[[i, k]] = even[[k, i]]
            own = np.where(np.arange(len(S)) == i, 0.0, even[:, j] / even[i, j])[:, None]
            even = above_rounding(even - own * even[i], np.abs(even) + np.abs(own * even[i]))
        whole = even[np.argsort(pivots, kind="stable")] * self.pair.model.units.outputs
        lead = np.argmax(whole != 0, axis=1)
        return whole * (np.sign(whole[np.arange(len(S)), lead]) / np.linalg.norm(whole, axis=1))[:, None]


def ignored_columns(plant: Plant, insensitive_to: Iterable[str | int] | str) -> IgnoredColumns:
    """Return what an observer of a plant has to ignore: all disturbances and the named faults.

    Raises
    ------
    DesignError
        If ``E`` is singular, or no measurement is left.
    """
    if is_singular(plant):
        raise DesignError(
            "eigenvectors are assigned to an observer of state equations, and E is singular: "
            "use decoupled_residual, which serves singular plants too"
        )
    plant = plant.explicit()
    chosen = arrays.positions(insensitive_to, plant.faults, "fault")
    names = plant.faults_as_disturbances([plant.faults[i] for i in chosen]).disturbances
    model = plant.balanced
    B, D = (np.hstack([model.disturbances[k], model.faults[k][:, chosen]]) for k in (0, 1))
    pair = error_pair(model, (B, D), 0, "even")
    if not len(pair.W):
        raise DesignError(f"no residual ignores {', '.join(names)}: they enter all {plant.n_outputs} outputs directly")
    pair = pair.white()
    left, direct = pair.inverse @ (B - pair.G @ D), np.any(D, axis=0)
    size = np.linalg.norm(left, axis=0)
    columns = {
        name: left[:, [i]] / size[i] for i, name in enumerate(names) if not direct[i] and size[i] > BALANCED_RANK
    }
    U, s, _ = np.linalg.svd(left[:, direct], full_matrices=False)  # those that the outputs express in part
    columns |= {f"ignored {i + 1}": U[:, [i]] for i in range(np.count_nonzero(s > BALANCED_RANK))}
    return IgnoredColumns(pair, columns, names, decide_rank(D, rtol=BALANCED_RANK, scale=1.0))


def require_detectable(parts: IgnoredColumns) -> None:
    """Raise when no observer that uses the outputs left over is stable."""
    model = parts.pair.model
    bad = unstable(parts.pair.A, parts.pair.C, model.plant.is_discrete)
    if bad.size:
        modes = describe_modes(model.units.rate * bad)
        raise DesignError(
            f"no stable observer of the whole state ignores {parts.text}: the measurements that are left do not see "
            f"the mode {modes}; add a sensor, or use decoupled_residual, which observes only what it needs"
        )
