"""A plant in balanced units, as ordinary state equations: the form for every analysis and design."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from residua.errors import ModelError
from residua.linear.subspaces.quotient import Quotient, explicit, observable_split, quotient
from residua.linear.subspaces.rank import decide_rank
from residua.linear.systems.scaling import Scaling, even_units, scaling
from residua.tolerances import BALANCED_RANK, BALANCED_STABLE, ROUNDING

if TYPE_CHECKING:
    from residua.plant.plant import Plant

Matrix = NDArray[np.float64]
#: A point where a plant has neither pole nor zero, but by chance.
_SOMEWHERE = 0.8317 + 0.6139j


@dataclass(frozen=True, eq=False)
class BalancedPlant:
    r"""A plant in units in which its entries are near one, with the states that ``E`` does not see as inputs.

    Without ``E`` these are :math:`\dot\xi = A \xi + B v, \; y = C \xi + D v` with time in units of ``1 / rate``. With
    one, the variables that ``E`` does not see are further unknown inputs, and its algebraic equations further outputs,
    which read zero.

    Attributes
    ----------
    plant : Plant
    units : Scaling
        ``inputs`` are those of the controls, the disturbances, then the faults.
    A, C : ndarray
    free : tuple of ndarray
        ``B`` and ``D`` of the variables that ``E`` does not see; no columns without ``E``.
    controls, disturbances, faults : tuple of ndarray
        ``B`` and ``D`` of each.
    derivative : ndarray, shape (states, n)
        ``T`` of :math:`\dot\xi = T (A x + \dots), \xi = T E x`, in balanced units.
    back : ndarray, shape (n, states + free)
        The states of the plant, balanced, from ``xi`` and the free variables.
    algebra : ndarray, shape (algebraic equations, n)
        Rows that annihilate ``E``.
    """

    plant: Plant
    units: Scaling
    A: Matrix
    C: Matrix
    free: tuple[Matrix, Matrix]
    controls: tuple[Matrix, Matrix]
    disturbances: tuple[Matrix, Matrix]
    faults: tuple[Matrix, Matrix]
    derivative: Matrix
    back: Matrix
    algebra: Matrix
    _quotients: dict[tuple[frozenset[int], float], Quotient] = field(default_factory=dict, repr=False)

    def unknown(self, ignored: Iterable[int] = ()) -> tuple[Matrix, Matrix]:
        """Return ``B`` and ``D`` of all unknown inputs: free variables, disturbances, and some faults."""
        chosen = sorted(ignored)
        return (
            np.hstack([self.free[0], self.disturbances[0], self.faults[0][:, chosen]]),
            np.hstack([self.free[1], self.disturbances[1], self.faults[1][:, chosen]]),
        )

    def quotient(self, ignored: Iterable[int] = (), *, tolerance: float = BALANCED_RANK) -> Quotient:
        """Return the quotient of the plant by the disturbances and some faults."""
        key = frozenset(ignored), tolerance
        if key not in self._quotients:
            B, D = self.unknown(key[0])
            k, n = len(self.A), self.back.shape[1] - len(self.A)
            P, R = self.back[:, :k], np.hstack([self.back[:, k:], np.zeros((len(self.back), B.shape[1] - n))])
            self._quotients[key] = quotient(self.A, B, self.C, D, P, R, tolerance=tolerance)
        return self._quotients[key]

    @cached_property
    def written(self) -> tuple[Matrix, Matrix, Matrix]:
        """``A``, ``C`` and ``E`` of the plant as given, in balanced units."""
        p, R, X = self.plant, self.units.equations[:, None], self.units.states
        E = np.eye(p.n_states) if p.E is None else R * p.E * X
        return R * p.A * X / self.units.rate, self.units.outputs[:, None] * p.C * X, E

    @cached_property
    def modes(self) -> NDArray[np.complex128]:
        """Eigenvalues of ``A``."""
        return np.asarray(np.linalg.eigvals(self.A), dtype=complex)

    @cached_property
    def dynamics(self) -> Matrix:
        """A matrix whose eigenvalues are the poles of the plant: without ``E``, ``A``."""
        if self.plant.E is None:
            return self.A
        k = self.plant.n_outputs
        return quotient(self.A, self.free[0], self.C[k:], self.free[1][k:]).pair[0]

    @cached_property
    def boundary(self) -> complex:
        """The point on the boundary of stability for constant signals: 0, or 1 for a sampled plant."""
        return 1.0 if self.plant.is_discrete else 0.0


def balanced(plant: Plant) -> BalancedPlant:
    """Return a plant in balanced units; computed once for a plant, as ``plant.balanced``."""
    roles = [(plant.B, plant.D), (plant.Bd, plant.Dd), (plant.Bf, plant.Df)]
    B, D = (np.hstack([role[k] for role in roles]) for k in (0, 1))
    units = scaling(plant.A, B, plant.C, D, plant.E, sampled=plant.is_discrete)
    R, X, U, Y = units.equations[:, None], units.states, units.inputs, units.outputs[:, None]
    A, B, C, D = R * plant.A * X / units.rate, R * B * U / units.rate, Y * plant.C * X, Y * D * U
    n = len(A)
    derivative, back, algebra, free = np.eye(n), np.eye(n), np.zeros((0, n)), 0
    if plant.E is not None:
        E = R * plant.E * X
        if not np.linalg.svd(_SOMEWHERE * E - A, compute_uv=False).min(initial=1.0) > BALANCED_RANK:
            raise ModelError("det(sE - A) is zero for every s: the model is not a plant (check E and A)")
        A, B, C, D, derivative, back, algebra = explicit(A, B, C, D, E)
        free = n - len(A)
    widths = np.cumsum([free, *(role[0].shape[1] for role in roles)])[:-1]
    parts = zip(np.split(B, widths, axis=1), np.split(D, widths, axis=1), strict=True)
    unseen, controls, disturbances, faults = parts
    return BalancedPlant(plant, units, A, C, unseen, controls, disturbances, faults, derivative, back, algebra)


def is_singular(plant: Plant) -> bool:
    """Tell whether the matrix ``E`` of a plant is singular."""
    if plant.E is None:
        return False
    rows, columns = even_units(plant.E)
    return decide_rank(rows[:, None] * plant.E * columns, rtol=1e-12).rank < plant.n_states


def is_inside(modes: NDArray[np.complex128], sampled: bool) -> NDArray[np.bool_]:
    """Tell for each mode of a balanced plant whether it is stable; the boundary counts as unstable.

    Inside by more than rounding: of the largest of them, in units of the rate of the plant, and of the plant itself.
    """
    if sampled:
        return np.abs(modes) < 1 - BALANCED_STABLE
    rounding = max(BALANCED_STABLE * float(np.abs(modes).max(initial=0.0)), ROUNDING)
    return np.real(modes) < -rounding


def undetectable(model: BalancedPlant, outputs: list[int] | None = None) -> NDArray[np.complex128]:
    """Return the unstable modes, in 1/s, that no output sees, or none of some."""
    modes = observable_split(model.A, model.C if outputs is None else model.C[outputs])
    found = np.asarray(np.linalg.eigvals(modes.hidden.T @ model.A @ modes.hidden), dtype=complex)
    return np.asarray(model.units.rate * found[~is_inside(found, model.plant.is_discrete)], dtype=complex)
