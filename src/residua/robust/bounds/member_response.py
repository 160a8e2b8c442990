"""Frequency responses of many members of an uncertain system at once, and their slopes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.poles.spectrum import spectral_radius
from residua.linear.systems.scaling import power_near, scaling
from residua.robust.sets.uncertain_system import UncertainSystem
from residua.tolerances import RESPONSE_ROUNDING

#: Real where every frequency is zero.
Array = NDArray
#: Sweeps from balanced units of states to units of what reaches them.
_SWEEPS = 4


@dataclass(frozen=True, eq=False)
class MemberResponse:
    """An uncertain system in units of states of its own, evaluated at points ``(parameters, theta)``.

    ``theta`` is rad/s for continuous systems and rad/sample for sampled ones, the last coordinate of every point.
    Sampled systems are held as ``A - I``, seen from ``z - 1``: these cancel where poles lie near one, exactly.

    Attributes
    ----------
    A, Bp, Bw, Cq, Cz, Dzp, Dzw : ndarray
    owners : ndarray of int
        The parameter of each channel.
    parameters : tuple of str
    dt : float
    constant : bool
        Whether only ``theta = 0`` is asked for: everything is real then.
    """

    A: Array
    Bp: Array
    Bw: Array
    Cq: Array
    Cz: Array
    Dzp: Array
    Dzw: Array
    owners: NDArray[np.intp]
    parameters: tuple[str, ...]
    dt: float
    constant: bool

    @property
    def origin(self) -> float:
        """What ``z`` is seen from: one for sampled systems, zero for ``s``."""
        return 1.0 if self.dt else 0.0

    def variable(self, theta: NDArray[np.float64]) -> Array:
        """Return ``s`` or ``z - 1`` at frequencies."""
        if self.constant:
            return np.zeros(theta.shape)
        return np.expm1(1j * theta) if self.dt else 1j * theta

    def members(self, values: NDArray[np.float64]) -> tuple[Array, Array]:
        """Return ``A``, less one where sampled, and ``C`` of members, shapes (count, n, n) and (count, p, n)."""
        F = values[:, self.owners][:, :, None] * self.Cq
        return self.A + self.Bp @ F, self.Cz + self.Dzp @ F

    def responses(self, points: NDArray[np.float64]) -> Array:
        """Return frequency responses, shape (count, p, m); infinite where a pole is in the way."""
        A, C = self.members(points[:, :-1])
        M = self.variable(points[:, -1])[:, None, None] * np.eye(len(self.A)) - A
        return C @ solved(M, np.broadcast_to(self.Bw, (len(M), *self.Bw.shape))) + self.Dzw

    def gains(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the smallest singular value at every point; infinite where a pole is in the way."""
        T = self.responses(points)
        fine = np.all(np.isfinite(T), axis=(1, 2))
        if T.shape[2] == 1:
            sizes = np.linalg.norm(T[:, :, 0], axis=1)
        else:
            sizes = np.linalg.svd(np.where(fine[:, None, None], T, 0.0), compute_uv=False)[:, -1]
        return np.where(fine, sizes, np.inf)

    def slopes(self, point: NDArray[np.float64]) -> tuple[Array, Array, float]:
        """Return the weakest column of the response, its slopes along every coordinate, and its rounding.

        The weakest column is ``T v`` for the unit input ``v`` with the smallest output; shapes (p,) and (p, q).
        """
        (A,), (C,) = self.members(point[None, :-1])
        z = self.variable(point[-1:])[0]
        R = np.linalg.inv(z * np.eye(len(A)) - A)
        B, D = self.Bw, self.Dzw
        T = C @ R @ B + D
        U, _, Vh = np.linalg.svd(T)
        v, weak = Vh[-1].conj(), U[:, len(Vh) - 1 :].conj().T
        x = R @ (B @ v)
        to_output = C @ R @ self.Bp + self.Dzp
        slopes = np.zeros((len(T), len(point)), dtype=complex)
        np.add.at(slopes.T, self.owners, (to_output * (self.Cq @ x)).T)
        if not self.constant:
            slopes[:, -1] = -(1j * (z + self.origin) if self.dt else 1j) * (C @ (R @ x))
        # of every input alone: the weakest combination of them is where they cancel
        size, states = np.abs(v), np.abs(R @ B) @ np.abs(v)
        terms = np.abs(C @ R) @ ((abs(z) + np.abs(A)) @ states + np.abs(B) @ size) + np.abs(C) @ states
        return weak @ (T @ v), weak @ slopes, RESPONSE_ROUNDING * float(np.linalg.norm(terms + np.abs(D) @ size))


def member_response(system: UncertainSystem, *, constant: bool) -> MemberResponse:
    """Return a system in units of states that do not depend on its own."""
    T = reached_units(system)
    return MemberResponse(
        (system.A - float(system.dt > 0) * np.eye(len(T))) / T[:, None] * T,
        system.Bp / T[:, None],
        system.Bw / T[:, None],
        system.Cq * T,
        system.Cz * T,
        system.Dzp,
        system.Dzw,
        np.array(system.channels, dtype=int),
        system.parameters,
        system.dt,
        constant,
    )


def balanced_states(system: UncertainSystem) -> NDArray[np.float64]:
    """Return balanced units of the states of a system with its uncertain channels."""
    B, C = np.hstack([system.Bw, system.Bp]), np.vstack([system.Cz, system.Cq])
    return scaling(system.A, B, C, np.zeros((len(C), B.shape[1])), sampled=system.dt > 0).states


def reached_units(system: UncertainSystem) -> NDArray[np.float64]:
    r"""Return units in which what reaches the states is about one.

    With the resolvent ``R`` of the centre at frequency zero, :math:`M = |R| (|z| I + |A| + |B_p F C_q|)` is what the
    rounding of states grows by on the way through the loop. In units of :math:`x = (I - M/c)^{-1} |R| |B_w|`, ``c``
    above its spectral radius, no row of ``M`` sums to more than ``c``. Balanced units alone may take the rounding of an
    entry that ought to be zero for a coupling, and scale a state that nothing drives without end.
    """
    units = balanced_states(system)
    own, one, z = list(system.channels), np.eye(len(units)), float(system.dt > 0)
    middle, widest = (system.low + system.high) / 2, np.maximum(np.abs(system.low), np.abs(system.high))
    for _ in range(_SWEEPS if len(units) else 0):
        A, Bw, Bp = (M / units[:, None] for M in (system.A * units, np.abs(system.Bw), system.Bp))
        Cq, Cz = system.Cq * units, system.Cz * units
        (R,) = solved((z * one - A - (Bp * middle[own]) @ Cq)[None], one[None])
        if not np.isfinite(R).all():
            break  # a pole at the centre: the visits to members will meet it
        M = np.abs(R) @ (z * one + np.abs(A) + (np.abs(Bp) * widest[own]) @ np.abs(Cq))
        reached, seen = np.abs(R) @ Bw, np.abs(Cz @ R) @ Bw + np.abs(system.Dzw)
        # inputs in units of what they do to the outputs
        effect = seen.sum(axis=0)
        rows = np.stack([(reached / np.where(effect > 0, effect, 1.0)).sum(axis=1), np.ones(len(one))], axis=1)
        beyond = 1.5 * float(spectral_radius(M)) or 1.0
        x = np.abs(np.linalg.solve(one - M / beyond, rows))
        units = units * power_near(np.where(x[:, 0] > 0, x[:, 0], x[:, 1]))
    return units if np.isfinite(units).all() and (units > 0).all() else np.ones_like(units)


def solved(M: Array, B: Array) -> Array:
    """Return ``M^-1 B`` for stacks of matrices; infinite where ``M`` is singular."""
    try:
        return np.linalg.solve(M, B)
    except np.linalg.LinAlgError:
        if len(M) == 1:
            return np.full(B.shape, np.inf, dtype=np.result_type(M, B))
        return np.concatenate([solved(M[i : i + 1], B[i : i + 1]) for i in range(len(M))])
