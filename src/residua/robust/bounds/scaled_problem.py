"""An uncertain system shifted and scaled so that parameters lie in [0, 1] and all numbers are of about one size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import ModelError
from residua.linear.norms.peak_norm_lmi import root
from residua.robust.bounds.reached_middle import reached_middle
from residua.robust.sets.uncertain_system import UncertainSystem

Matrix = NDArray[np.float64]
#: Channels below this fraction of the largest of their parameter are rounding of its factors.
_INDEPENDENT = 1e-12
#: The least extent, squared, of the ellipsoid that gives the coordinates, relative to the extents of its states.
_FLOOR = 1e-5


@dataclass(frozen=True, eq=False)
class ScaledProblem:
    """``x+ = A x + B p + D w``, ``q = C x``, ``p = F q`` with ``0 <= F <= 1``, ``z = Cz x + Dzp p + Dzw w``.

    In coordinates in which an ellipsoid about what inputs reach in the middle of the set, by way of parameters as well,
    is the unit ball, and ``z`` in units of what it gets to there.

    Attributes
    ----------
    A, B, D, C, Cz, Dzp, Dzw : ndarray
    groups : tuple of tuple of int
        The channels of each parameter that is left.
    owners : tuple of int
        Its position among the parameters of the system.
    unit : float
        What ``z`` was divided by.
    T : ndarray, shape (n, n)
        ``x = T x_scaled``.
    """

    A: Matrix
    B: Matrix
    D: Matrix
    C: Matrix
    Cz: Matrix
    Dzp: Matrix
    Dzw: Matrix
    groups: tuple[tuple[int, ...], ...]
    owners: tuple[int, ...]
    unit: float
    T: Matrix

    def widest(self) -> float:
        """Return the parameter that moves the system most, as a position among those of the system; NaN without any."""
        if not self.groups:
            return np.nan
        sizes = [np.linalg.norm(self.B[:, list(g)] @ self.C[list(g)]) for g in self.groups]
        return self.owners[int(np.argmax(sizes))]

    @property
    def n_channels(self) -> int:
        """Number of channels."""
        return self.B.shape[1]


def check_sampled(system: UncertainSystem) -> None:
    """Raise unless it is an uncertain system in sampled time."""
    if not isinstance(system, UncertainSystem):
        raise ModelError(
            f"the robust peak norm takes an UncertainSystem, got {type(system).__name__}: an uncertain plant makes one "
            "with in_closed_loop(controller).estimator_residual(gain, projection)"
        )
    if not system.dt:
        raise ModelError(
            "the robust peak norm is that of a sampled system, and this one is continuous: sample the plant first, "
            "UncertainPlant.discretize(dt), and see there what that leaves out"
        )


def scaled_problem(system: UncertainSystem) -> ScaledProblem:
    """Shift, scale and thin out the channels of an uncertain system.

    Parameters of zero width and channels without effect are dropped; several channels of one parameter are reduced to
    the rank of what they do together.
    """
    low, width = system.low, system.high - system.low
    own = np.array(system.channels, dtype=int)
    shift = low[own][:, None] * system.Cq
    A, Cz = system.A + system.Bp @ shift, system.Cz + system.Dzp @ shift
    reached = reached_middle(system)
    T, unit, rate = reached.middle.units[:, None] * root(reached.Q, _FLOOR), reached.unit, reached.rate
    back = np.linalg.inv(T)
    n = len(A)
    scale = np.concatenate([np.ones(n), np.full(len(Cz), np.sqrt(rate) / unit)])
    left, right, groups, owners = [np.zeros((len(scale), 0))], [np.zeros((0, n))], [], []
    for i in range(system.n_parameters):
        mine = np.flatnonzero(own == i)
        effect = np.vstack([back @ system.Bp[:, mine], system.Dzp[:, mine]]) * scale[:, None]
        U, s, Vh = np.linalg.svd(width[i] * effect @ (system.Cq[mine] @ T), full_matrices=False)
        keep = s > max(_INDEPENDENT * s.max(initial=0.0), 1e-15)
        if not keep.any():
            continue
        count = sum(len(g) for g in groups)
        groups.append(tuple(range(count, count + int(keep.sum()))))
        owners.append(i)
        half = np.sqrt(s[keep])
        left.append(U[:, keep] * half / scale[:, None])
        right.append(half[:, None] * Vh[keep])
    both = np.hstack(left)
    return ScaledProblem(
        back @ A @ T,
        both[:n],
        back @ system.Bw,
        np.vstack(right),
        Cz @ T / unit,
        both[n:] / unit,
        system.Dzw / unit,
        tuple(groups),
        tuple(owners),
        unit,
        T,
    )
