r"""Decoupling of known inputs and disturbances from residuals and estimates: the promise of a design, and its check.

With the state :math:`\xi = T E x + e` of a filter, what does not cancel is known algebraically: the *defects*

.. math::

   \Delta_A = F T E + G_y C - T A, \quad \Delta_B = G_u + G_y D - T B, \quad
   \Delta_C = L T E + J_y C + V A, \quad \Delta_D = J_u + J_y D + V B

of a filter :math:`\dot\xi = F \xi + G_u u + G_y y, \; r = L \xi + J_u u + J_y y`. The response of the residual is
:math:`L (s - F)^{-1} (\Delta_A X + \Delta_B) + \Delta_C X + \Delta_D` with :math:`X = (s E - A)^{-1} B`: no difference
of large numbers at any frequency. The defects are computed in extended precision, the rest in double.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.design.core.balanced_filter import BalancedFilter, Matrix, Resolvent, extended_sum
from residua.design.core.evidence import measured_from
from residua.errors import AccuracyError
from residua.linear import StateSpace
from residua.linear.systems.scaling import power_near
from residua.plant import Plant
from residua.tolerances import LEAK

#: The entry of the evidence for the disturbances and the faults that are ignored, together.
IGNORED = "everything ignored"
#: A term this far below what it is made of, or below the largest of its input, is rounding.
_NO_TERM = 1e-9
#: Terms are at least this part of the largest of their input: where nothing has to cancel, rounding is all there is.
_LEAST_TERM = 1e-5
#: Complex numbers in the largest arrays: what caches hold.
_AT_ONCE = 400_000
#: Leaks by the entry of the evidence, and the conditions that say how they were measured, if they were.
Leaks = tuple[dict[str, float], dict[str, float]]


@dataclass(frozen=True)
class Decoupled:
    """An exact design: no control reaches its residual, nor the disturbances, nor the faults that it ignores.

    Attributes
    ----------
    disturbances : bool
        Whether the disturbances are decoupled too. A design that only attenuates them says ``False``.
    faults : tuple of str
        The faults that are decoupled as if they were disturbances.
    apart : bool
        Whether the evidence has the disturbances by themselves too where faults are ignored with them.
    """

    disturbances: bool = True
    faults: tuple[str, ...] = ()
    apart: bool = False

    def leaks(self, f: BalancedFilter | None) -> Leaks:
        """Return the leaks of a filter with a state map, and the error of its identities; or raise."""
        assert f is not None
        plant = f.plant
        ignored = [plant.faults.index(name) for name in self.faults]
        Bd, Dd = (plant.Bd, plant.Dd) if self.disturbances else (plant.Bd[:, :0], plant.Dd[:, :0])
        found = leak_of(f, np.hstack([Bd, plant.Bf[:, ignored]]), np.hstack([Dd, plant.Df[:, ignored]]))
        n_u = len(plant.inputs)
        gains = {"control": found.gains[:, :n_u]}
        if self.disturbances and (self.apart or not self.faults):
            gains |= {"disturbance": found.gains[:, n_u : n_u + len(plant.disturbances)]}
        if self.faults:
            gains |= {IGNORED: found.gains[:, n_u:]}
        leaks = self._accepted({name: float(part.max()) for name, part in gains.items() if part.size})
        _accept(found.defects)
        conditions = measured_from(found.slowest, plant.dt) if leaks else {}
        return leaks, {"identities": found.defects} | conditions

    def _accepted(self, leaks: dict[str, float]) -> dict[str, float]:
        for name, gain in leaks.items():
            if not gain <= LEAK:
                what = f"the {name} inputs" if name != IGNORED else f"{', '.join(self.faults)}, which it should ignore"
                raise AccuracyError(
                    f"the residual answers to {what} (by {gain:.2g} > {LEAK:.0e} of the terms that should "
                    "cancel): the plant is too badly conditioned for this design; ask for other poles, or use "
                    "decoupled_residual"
                )
        return leaks


@dataclass(frozen=True)
class Approximate:
    """A filter that controls and disturbances reach a little, as its evidence says: measured elsewhere, or approximate.

    Attributes
    ----------
    entry : str
        The entry of ``decoupling`` or ``conditions`` that holds this number; empty where no input can reach it.
    """

    entry: str

    def leaks(self, f: BalancedFilter | None) -> Leaks:
        """Return no leaks, and the error of the identities of a filter with a state map; or raise."""
        return {}, {} if f is None else {"identities": _accept(largest_defect(f))}


def _accept(defects: float) -> float:
    """Return the error of the identities of a filter, or raise for a large one."""
    if not defects <= LEAK:
        raise AccuracyError(
            "the states of the filter are no function of those of the plant: its equations miss by "
            f"{defects:.2g} > {LEAK:.0e}; check its state_map, or ask for slower poles"
        )
    return defects


#: What a design says of the controls and disturbances of its plant.
Promise = Decoupled | Approximate


@dataclass(frozen=True, eq=False)
class Leak:
    """The leaks of a filter.

    Attributes
    ----------
    gains : ndarray, shape (residuals, inputs)
        Peak of the response over frequency, over the peak of the sum of the sizes of its terms: 1e-16 is exact, 1 is
        no decoupling. No number has a unit.
    defects : float
        The largest entry of the defects of what is read, in balanced units: how far the identities are missed.
    slowest : float
        The lowest frequency, in rad/s.
    """

    gains: Matrix
    defects: float
    slowest: float


def leak(
    system: StateSpace,
    plant: Plant,
    state_map: Matrix,
    static_map: Matrix | None = None,
    *,
    unknown: tuple[Matrix, Matrix] | None = None,
    estimate: Matrix | None = None,
) -> Leak:
    """Return the leaks of controls and other inputs of a plant into the outputs of a filter.

    Parameters
    ----------
    system : StateSpace
        From controls and outputs of the plant to residuals or estimates.
    plant : Plant
    state_map : ndarray, shape (states of the filter, n)
        ``T``.
    static_map : ndarray, shape (outputs of the filter, n), optional
        ``V``, with ``V E = 0``.
    unknown : tuple of ndarray, optional
        ``B`` and ``D`` of further inputs, which must not be seen; the disturbances when omitted.
    estimate : ndarray, shape (outputs of the filter, n), optional
        What the outputs estimate, ``M x``: the error is looked at, relative to the peak of what is estimated.
    """
    unknown = (plant.Bd, plant.Dd) if unknown is None else unknown
    return leak_of(BalancedFilter.of(system, plant, state_map, static_map, estimate), *unknown, estimate is not None)


def leak_of(f: BalancedFilter, Bd: Matrix, Dd: Matrix, of_estimate: bool = False) -> Leak:
    """Return the leaks of controls and further inputs, given by ``B`` and ``D``, into the outputs of a filter."""
    plant = f.plant
    B, D, U = f.entering(np.hstack([plant.B, Bd]), np.hstack([plant.D, Dd]))
    U, none = U[: len(plant.inputs)], (len(U) - len(plant.inputs), 0)
    Gu, Ju = np.pad(f.Gu * U, ((0, 0), none[::-1])), np.pad(f.Ju * U, ((0, 0), none[::-1]))
    dA = extended_sum((f.F, f.T, f.E), (f.Gy, f.C), (-f.T, f.A))
    dB = extended_sum((Gu,), (f.Gy, D), (-f.T, B))
    dC = extended_sum((f.L, f.T, f.E), (f.Jy, f.C), (f.V, f.A), (-f.estimate,))
    dD = extended_sum((Ju,), (f.Jy, D), (f.V, B))
    s, shape = f.points, (len(f.L), B.shape[1])
    peak, terms, largest = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for some in np.array_split(s, 1 + len(s) * max(len(f.A), len(f.F)) * (shape[1] + f.Gy.shape[1]) // _AT_ONCE):
        x = f.of_plant(B, some)
        missed = f.of_filter(dA @ x + dB, some)
        peak = np.maximum(peak, np.abs(f.L @ missed + dC @ x + dD).max(axis=0, initial=0.0))
        if of_estimate:
            terms = np.maximum(terms, np.abs(f.estimate @ x).max(axis=0, initial=0.0))
            continue
        Q = f.read(some)
        P = np.maximum(np.abs(f.C @ x + D), _NO_TERM * (np.abs(f.C) @ np.abs(x) + np.abs(D)))
        terms = np.maximum(terms, (np.abs(Ju) + Q @ P).max(axis=0, initial=0.0))
        together = Q.max(axis=2, initial=0.0)[:, :, None] * P.max(axis=1, initial=0.0)[:, None, :]
        largest = np.maximum(largest, together.max(axis=0, initial=0.0))
    if of_estimate:
        largest = np.full(shape, max(1.0, terms.max(initial=0.0)))
    terms = np.maximum(terms, _LEAST_TERM * np.maximum(largest, terms.max(axis=0, keepdims=True, initial=0.0)))
    # an input that reaches no output has terms of rounding alone
    terms = np.maximum(terms, _NO_TERM * largest.max(axis=1, keepdims=True, initial=0.0))
    gains = peak / np.where(terms > 0, terms, np.where(peak > 0, peak, 1.0))
    return Leak(gains, _largest_read(f, dA, dC), f.slowest)


def largest_defect(f: BalancedFilter) -> float:
    """Return the largest entry of the defects that the residual reads, in double precision."""
    return _largest_read(f, f.F @ f.T @ f.E + f.Gy @ f.C - f.T @ f.A, f.L @ f.T @ f.E + f.Jy @ f.C + f.V @ f.A)


def _largest_read(f: BalancedFilter, dA: Matrix, dC: Matrix) -> float:
    # a row of which rounding is all there is was scaled up to one: it counts by how far others read it
    used = np.minimum(np.abs(np.vstack([f.L, f.F - np.diag(np.diag(f.F))])).max(axis=0, initial=0.0), 1.0)
    return max((float(np.abs(M).max(initial=0.0)) for M in (used[:, None] * dA, dC)), default=0.0)


def reached(
    system: StateSpace, plant: Plant, state_map: Matrix | None, static_map: Matrix | None = None
) -> dict[str, float]:
    """Return the largest gains from ``"control"`` and ``"disturbance"``, if the plant has any, to a filter.

    From its defects where it has a state map, else from its response.
    """
    gains = reached_inputs(system, plant, state_map, static_map)
    n_u = len(plant.inputs)
    groups = {"control": gains[:n_u], "disturbance": gains[n_u:]}
    return {name: float(part.max()) for name, part in groups.items() if len(part)}


def reached_inputs(
    system: StateSpace, plant: Plant, state_map: Matrix | None, static_map: Matrix | None = None
) -> Matrix:
    """Return the largest gain from each control, then each disturbance, to any residual of a filter.

    Without a state map, as of a sampled filter, it is the peak of the response over the peak of the sum of the sizes of
    its terms. The response is the sum of what goes through the filter directly and through the plant: rounding of these
    terms, 1e-16 of them, is part of it.
    """
    if state_map is not None:
        return leak(system, plant, state_map, static_map).gains.max(axis=0, initial=0.0)
    f, n_u = BalancedFilter.of(system, plant, np.zeros((system.n_states, plant.n_states))), len(plant.inputs)
    B, D, U = f.entering(np.hstack([plant.B, plant.Bd]), np.hstack([plant.D, plant.Dd]))
    Q = f.L @ f.of_filter(np.hstack([f.Gu * U[:n_u], f.Gy]), f.points) + np.hstack([f.Ju * U[:n_u], f.Jy])
    P = f.C @ f.of_plant(B, f.points) + D
    response, terms = Q[..., n_u:] @ P, np.abs(Q[..., n_u:]) @ np.abs(P)
    response[..., :n_u] += Q[..., :n_u]
    terms[..., :n_u] += np.abs(Q[..., :n_u])
    peak, terms = np.abs(response).max(axis=0, initial=0.0), terms.max(axis=0, initial=0.0)
    return (peak / np.where(terms > 0, terms, 1.0)).max(axis=0, initial=0.0)


def answers(system: StateSpace, plant: Plant, terms: Matrix) -> NDArray[np.bool_]:
    """Tell the residuals that answer to the measurements by more than rounding, at some frequency.

    Parameters
    ----------
    system : StateSpace
        From controls and outputs of the plant to residuals.
    plant : Plant
    terms : ndarray, shape (residuals, outputs)
        The sizes of what the direct responses to the outputs are made of.
    """
    units, n_u = plant.balanced.units, len(plant.inputs)
    G = system.B[:, n_u:] / units.outputs / units.rate
    scales = 1 / power_near(np.abs(G).max(axis=1, initial=0.0))[:, None]
    L = system.C / scales[:, 0]
    w = np.geomspace(1e-3, 3.0, 7) if plant.is_discrete else np.geomspace(1e-3, 1e2, 7)
    resolvent = Resolvent.of(scales * system.A / scales[:, 0] / units.rate, None)
    states = resolvent(scales * G, np.asarray(np.exp(1j * w) if plant.is_discrete else 1j * w, dtype=complex))
    response = np.abs(L @ states + system.D[:, n_u:] / units.outputs)
    made_of = np.abs(L) @ np.abs(states) + terms / units.outputs
    return np.any(response > _NO_TERM * made_of.max(axis=2, keepdims=True, initial=0.0), axis=(0, 2))
