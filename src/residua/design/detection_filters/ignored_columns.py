"""What a full-order observer has to ignore: its columns in balanced units, taken out of the outputs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua import arrays
from residua.design.observers.observer_gain import gain_size
from residua.errors import DesignError
from residua.linear.poles.spectrum import describe_modes
from residua.linear.subspaces.observability import detectability
from residua.linear.subspaces.rank import RankDecision, decide_rank, range_basis, without_rounded_gains
from residua.linear.systems.balancing import descriptor_units, power_of_two, without_rounding
from residua.plant import Plant
from residua.tolerances import RESIDUE, above_rounding


@dataclass(frozen=True, eq=False)
class IgnoredColumns:
    r"""A plant in balanced units whose ignored inputs have been taken out of the outputs that are used.

    With :math:`D_Z = U_1 S V_1^T`, the outputs :math:`W y`, :math:`W D_Z = 0`, do not see the ignored inputs
    directly; the part of these that the others see is expressed by them, :math:`A_0 = A - G C`, :math:`C_0 = W C`.
    For any gain ``K0`` on these, :math:`K = G + K_0 W` gives :math:`A - K C = A_0 - K_0 C_0`. A sensor whose fault is
    to be ignored is not used: ``W`` leaves it out and its column of ``G`` is zero.

    Attributes
    ----------
    plant : Plant
        With invertible ``E`` divided out.
    watched : Plant
        The same with the ignored faults among the disturbances: what no residual may see.
    A, C : ndarray
        ``A0`` and ``C0``.
    columns : dict of str to ndarray, shape (n, 1)
        Directions left to be ignored in the state equation: unit vectors, one for each ignored input that has such.
    G, W : ndarray
    states, outputs : ndarray
        The units: states are ``x / states``, outputs ``outputs * y``.
    direct : RankDecision
        Rank of the ignored inputs in the outputs.
    """

    plant: Plant
    watched: Plant
    A: NDArray[np.float64]
    C: NDArray[np.float64]
    columns: dict[str, NDArray[np.float64]]
    G: NDArray[np.float64]
    W: NDArray[np.float64]
    states: NDArray[np.float64]
    outputs: NDArray[np.float64]
    direct: RankDecision

    @property
    def names(self) -> tuple[str, ...]:
        """Everything that is to be ignored: the disturbances, then the faults named."""
        return self.watched.disturbances

    @property
    def text(self) -> str:
        """The same in words."""
        return ", ".join(f"'{name}'" for name in self.names) or "nothing"

    @property
    def stacked(self) -> NDArray[np.float64]:
        """The columns side by side."""
        return np.hstack([np.zeros((len(self.A), 0)), *self.columns.values()])

    def on_all_outputs(self, K0: NDArray) -> NDArray[np.float64]:
        """Return ``K`` in balanced units of the states, without what rounding would couple them by."""
        return without_rounded_gains(self.G + K0 @ self.W) * self.outputs

    def observer_gain(self, K0: NDArray) -> NDArray[np.float64]:
        """Return ``K`` in the units of the plant."""
        return self.states[:, None] * self.on_all_outputs(K0)

    def size_of(self, F: NDArray, K: NDArray) -> float:
        """Return the size of a gain in the units of the plant, whose error equation has the state matrix ``F``."""
        S, Y = self.states, self.outputs
        return gain_size(F / S[:, None] * S, K / S[:, None] / Y, Y[:, None] * self.plant.C * S)

    def with_even_rows(self, S0: NDArray) -> NDArray[np.float64]:
        """Return rows for the outputs that are used, with lengths near one in the units of the plant.

        Their length is one in balanced units, times a power of two, so that the rest of a design rounds alike in all
        units. Their first entry is positive.
        """
        S0 = above_rounding(S0, np.abs(S0).max(axis=1, keepdims=True, initial=0.0), RESIDUE)
        S0 = S0 / np.linalg.norm(S0, axis=1, keepdims=True)
        S = S0 @ self.W * self.outputs
        lead = np.argmax(np.abs(S) > 1e-9 * np.abs(S).max(axis=1, keepdims=True, initial=0.0), axis=1)
        return S0 * (np.sign(S[np.arange(len(S)), lead]) / power_of_two(np.linalg.norm(S, axis=1)))[:, None]


@dataclass(frozen=True, eq=False)
class Frame:
    """Coordinates ``T x`` of the balanced states, of which the residual sees the first ``seen`` only."""

    T: NDArray[np.float64]
    inverse: NDArray[np.float64]
    seen: int


def ignored_columns(plant: Plant, insensitive_to: Iterable[str | int] | str, *, rtol: float) -> IgnoredColumns:
    """Return what an observer of a plant has to ignore: all disturbances and the named faults.

    Raises
    ------
    DesignError
        If no measurement is left, or those left do not see an unstable mode.
    """
    if plant.E is not None and decide_rank(plant.E).rank < plant.n_states:
        raise DesignError(
            "eigenvectors are assigned to an observer of state equations, and E is singular: "
            "use decoupled_residual, which serves singular plants too"
        )
    plant = plant.explicit()
    named = [plant.faults[i] for i in arrays.positions(insensitive_to, plant.faults, "fault")]
    watched = plant.faults_as_disturbances(named)
    n = plant.n_states
    B_all = np.hstack([plant.B, plant.Bd, plant.Bf])
    units = descriptor_units(plant.A, None, B_all, plant.C, np.hstack([plant.D, plant.Dd, plant.Df]))
    R, Y = units.equations[:, None], units.outputs[:, None]
    A, C = R * plant.A * units.states, Y * plant.C * units.states
    unknown = np.vstack([R * watched.Bd, Y * watched.Dd])
    size = np.linalg.norm(unknown, axis=0)
    unknown = unknown / np.where(size > 0, size, 1.0)
    U, s, Vh = np.linalg.svd(unknown[n:])
    direct = decide_rank(unknown[n:], rtol=rtol, scale=1.0)
    k = direct.rank
    if not k:
        G, W, left = np.zeros((n, len(C))), np.eye(len(C)), unknown[:n]
    else:
        G = without_rounding(unknown[:n], Vh[:k].T / s[:k], U[:, :k].T)
        W = above_rounding(U[:, k:].T, 1.0, RESIDUE)
        left = without_rounding(unknown[:n], np.eye(unknown.shape[1]) - Vh[:k].T @ Vh[:k])
    columns = _columns(left, np.any(unknown[n:], axis=0), watched.disturbances, rtol)
    if not len(W):
        raise DesignError(
            f"no residual ignores {', '.join(watched.disturbances)}: they enter all {plant.n_outputs} outputs directly"
        )
    return IgnoredColumns(
        plant,
        watched,
        without_rounding(np.hstack([np.eye(n), -G]), np.vstack([A, C])),
        without_rounding(W, C),
        columns,
        G,
        W,
        units.states,
        units.outputs,
        direct,
    )


def _columns(left: NDArray, direct: NDArray, names: tuple[str, ...], rtol: float) -> dict[str, NDArray[np.float64]]:
    """Return the columns left in the state equation, as unit columns.

    One for each input that does not enter the outputs; of the others, which the outputs express in part, a basis.
    """
    size = np.linalg.norm(left, axis=0)
    own = {name: left[:, [i]] / size[i] for i, name in enumerate(names) if not direct[i] and size[i] > rtol}
    basis, _ = range_basis(left[:, direct], rtol=rtol, scale=1.0)
    return own | {f"ignored {i + 1}": basis[:, [i]] for i in range(basis.shape[1])}


def require_detectable(parts: IgnoredColumns, *, rtol: float) -> None:
    """Raise when no observer that uses the outputs left over is stable."""
    answer = detectability(parts.A, parts.C, dt=parts.plant.dt, rtol=rtol)
    if not answer:
        bad = describe_modes(answer.unstable_modes)
        raise DesignError(
            f"no stable observer of the whole state ignores {parts.text}: the measurements that are left do not see "
            f"the mode {bad}; add a sensor, or use decoupled_residual, which observes only what it needs"
        )
