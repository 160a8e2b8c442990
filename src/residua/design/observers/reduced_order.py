"""The algebra of observers of order n - p, for plants with and without singular E and with unknown inputs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.design.core.evidence import Evidence
from residua.design.observers.observer import Observer, with_checked_estimate
from residua.design.observers.observer_gain import asked, default_weights, gain_evidence
from residua.design.observers.unknown_input_observer import in_units_of_outputs
from residua.errors import DesignError
from residua.linear.poles.observer_gain import observer_gain
from residua.linear.poles.spectrum import describe_modes
from residua.linear.subspaces.quotient import Quotient, observable_split, quotient, without_rounding
from residua.linear.subspaces.rank import RankDecision
from residua.plant import Plant
from residua.plant.balanced import BalancedPlant, is_inside
from residua.tolerances import BALANCED_RANK


def reduced_observer(
    plant: Plant,
    method: str,
    reference: str,
    *,
    poles: Sequence[complex] | ArrayLike | None,
    margin: float | None,
    outputs: Iterable[str | int] | str | None,
) -> Observer:
    r"""Return the observer of order n - p.

    Of the plant without its unknown inputs, :math:`\dot z = F z + J y, \; H y = G z`, the measurements determine
    :math:`a = V_1^T z` by :math:`G`; only :math:`b = V_2^T z` is estimated, by an observer of
    :math:`\dot b = A_{22} b + A_{21} a + \dots` that reads :math:`\dot a = A_{12} b + \dots`: with
    :math:`w = b - L a` nothing is differentiated.
    """
    used = arrays.different_positions(outputs, plant.outputs, "output")
    model, p = plant.balanced, plant.n_outputs
    rows = [*used, *range(p, p + len(model.algebra))]
    q = _quotient_of(model, rows)
    F, G = q.pair
    U, s, Vh = np.linalg.svd(G) if G.size else (np.eye(len(G)), np.zeros(0), np.eye(len(F)))
    k = int(np.count_nonzero(s > BALANCED_RANK))
    U, Vh = without_rounding(U), without_rounding(Vh)
    V1, V2 = Vh[:k].T, Vh[k:].T
    reading = (U[:, :k] / s[:k]).T @ q.H  # a from the outputs
    A11, A12, A21, A22 = V1.T @ F @ V1, V1.T @ F @ V2, V2.T @ F @ V1, V2.T @ F @ V2
    poles, margin = asked(plant, poles, margin)
    if not len(A22) and poles is not None and len(poles):
        raise DesignError("there is nothing to place: the measurements determine all states, the order is 0")
    process, _ = default_weights(model)
    process = q.N @ process @ q.N.T
    gain = observer_gain(
        A22,
        A12,
        observable_split(A22, A12),
        sampled=plant.is_discrete,
        process=V2.T @ process @ V2,
        measurement=V1.T @ process @ V1,
        poles=poles,
        margin=margin,
        rate=model.units.rate,
    )
    L = gain.K
    own = A22 - L @ A12
    down = V2.T - L @ V1.T
    K = without_rounding((own @ L + A21 - L @ A11) @ reading + down @ q.J)
    out = without_rounding(q.P - q.R @ q.known[0] @ q.C)
    inverse = without_rounding(out @ (V1 + V2 @ L) @ reading + q.R @ q.known[0])
    units = model.units
    R, X, Y, n_used = units.equations, units.states[:, None], units.outputs, len(used)
    evidence = Evidence(
        method=method,
        ranks={"independent measurements": RankDecision(k, s, BALANCED_RANK)},
        conditions={"pole error": gain.error, "size of L": gain.norm},
        notes=(f"uses {', '.join(plant.outputs[i] for i in used)}",) if n_used < p else (),
        references=(reference,),
    )
    made = Observer(
        plant,
        units.rate * own,
        without_rounding(down @ q.N @ model.derivative - K[:, n_used:] @ model.algebra) * R,
        _embedded(units.rate * K[:, :n_used] * Y[used], used, p),
        X * without_rounding(out @ V2),
        _embedded(X * inverse[:, :n_used] * Y[used], used, p),
        _unused(model, used),
        method,
        True,
        evidence.extended(**gain_evidence(gain, units.rate)),
        J=X * (inverse[:, n_used:] @ model.algebra) * R / units.rate if plant.E is not None else None,
    )
    return with_checked_estimate(made)


def _quotient_of(model: BalancedPlant, rows: list[int]) -> Quotient:
    """Return the quotient by the disturbances of a plant with some of its outputs, or raise where none will do."""
    plant, (B, D) = model.plant, model.unknown()
    n = len(model.A)
    P = model.back[:, :n]
    R = np.hstack([model.back[:, n:], np.zeros((len(P), B.shape[1] - model.back.shape[1] + n))])
    q = quotient(model.A, B, model.C[rows], D[rows], P, R)
    if not q.proper:
        raise DesignError(
            "rank [E D; C 0] < n + rank D: the measurements do not determine what the equations leave open; "
            + (
                f"add a sensor or decouple fewer disturbances than {', '.join(plant.disturbances)}"
                if plant.disturbances
                else "add a sensor that sees the states without equations of their own"
            )
        )
    modes = q.hidden_modes
    unstable = model.units.rate * modes[~is_inside(modes, plant.is_discrete)]
    if unstable.size:
        raise DesignError(
            f"not detectable: the measurements that are used do not see the mode {describe_modes(unstable)}, or the "
            "disturbances hide it, and it is not stable; add a sensor, or decouple other disturbances"
        )
    return q


def _embedded(columns: NDArray[np.float64], used: list[int], p: int) -> NDArray[np.float64]:
    out = np.zeros((len(columns), p))
    out[:, used] = columns
    return out


def _unused(model: BalancedPlant, used: list[int]) -> NDArray[np.float64]:
    """Return the combinations of unused outputs that no disturbance enters: their errors are the residual."""
    p = model.plant.n_outputs
    rest = [i for i in range(p) if i not in set(used)] or list(
        range(p)
    )  # of more outputs than states some are redundant
    D = model.disturbances[1][rest]
    if not np.any(D):
        return np.eye(p)[rest]
    U, s, _ = np.linalg.svd(D)
    left = U[:, int(np.count_nonzero(s > BALANCED_RANK)) :].T
    return in_units_of_outputs(_embedded(left * model.units.outputs[rest], rest, p))
