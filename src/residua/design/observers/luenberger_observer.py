"""Luenberger's observer: full order, nothing decoupled."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from residua import arrays
from residua.analysis.unknown_input import is_singular
from residua.design.core.evidence import Evidence
from residua.design.core.method import method
from residua.design.core.own_time import in_own_time
from residua.design.observers.estimate_check import check_estimate
from residua.design.observers.observer import Observer, in_units_of_the_plant, kept_observer_for
from residua.design.observers.observer_gain import gain_size, place, pole_evidence
from residua.errors import DesignError
from residua.linear.subspaces.rank import DEFAULT_RTOL, without_rounded_gains
from residua.linear.systems.array_cache import cached_by_contents
from residua.linear.systems.balancing import without_rounding
from residua.plant import Plant
from residua.plant.comparable_units import even_plant


@method(
    exists_when="(C, A) detectable",
    order="n",
    source="Twardy and Kaczorek, part I, Theorems 1 and 2",
    state="estimate, converges",
)
@in_own_time()
def luenberger_observer(
    plant: Plant,
    *,
    poles: Sequence[complex] | ArrayLike | None = None,
    margin: float | None = None,
    outputs: Iterable[str | int] | str | None = None,
    rtol: float = DEFAULT_RTOL,
) -> Observer:
    r"""Design a full-order observer by pole placement.

    .. math:: \dot z = (A - K C) z + B u + K y, \qquad \hat x = z

    Guaranteed: without disturbances the error obeys :math:`\dot e = (A - KC) e`. It exists exactly when the pair
    :math:`(C, A)` is detectable: a pair that is not observable goes through the observability form, its
    unobservable modes stay where they are and are reported as ``evidence.fixed_poles``.

    Parameters
    ----------
    plant : Plant
        Continuous or sampled, with invertible ``E``. Its disturbances are not decoupled.
    poles : sequence of complex, optional
        Poles of the error, closed under conjugation: as many as states, or as many as are observable.
    margin : float, optional
        Stability margin in 1/s, used without ``poles``; when omitted, the geometric mean of the sizes of the
        plant's poles.
    outputs : sequence of str, optional
        The measurements that drive the observer, all when omitted. The residual is the error of these.
    rtol : float
        Relative tolerance of every rank decision.

    Returns
    -------
    Observer

    Raises
    ------
    DesignError
        If a mode that no measurement sees is not stable; the message names it.
    AccuracyError
        If the poles missed their tolerance.

    See Also
    --------
    kalman_filter : The gain follows from the noise.
    unknown_input_observer : No disturbance reaches the estimate.
    reduced_order_observer : Of the order n - p.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant.

    References
    ----------
    Twardy and Kaczorek, part I, Theorems 1 and 2 and steps 5 to 10 of Procedure 1.

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.Plant([[0, 1], [-2, -3]], [[0], [1]], [[1, 0]])
    >>> rs.design.luenberger_observer(plant, poles=[-4, -5]).K.ravel().round(9) + 0.0
    array([6., 0.])
    """
    if is_singular(plant):
        raise DesignError(
            "Luenberger's observer needs state equations, and E is singular: use descriptor_observer, or "
            "unknown_input_observer, which also serves singular plants without disturbances"
        )
    used = arrays.different_positions(outputs, plant.outputs, "output")
    return kept_observer_for(plant, lambda own: _designed(own, used, poles, margin, rtol))


@cached_by_contents
def _designed(
    plant: Plant,
    used: list[int],
    poles: Sequence[complex] | ArrayLike | None,
    margin: float | None,
    rtol: float,
) -> Observer:
    """Return the observer of a plant in its own units that uses the numbered outputs."""
    original, even = plant.explicit(), even_plant(plant, explicit=True)
    plant = even.plant
    placed = place(plant.A, plant.C[used], poles, margin, plant.dt, rtol)
    n, W = plant.n_states, np.eye(plant.n_outputs)[used]
    K = without_rounded_gains(placed.gain) @ W  # which would couple states that nothing couples
    F = without_rounding(np.hstack([np.eye(n), -K]), np.vstack([plant.A, plant.C]))
    names = ", ".join(plant.disturbances)
    evidence = Evidence(
        method="Luenberger observer",
        **pole_evidence(placed, F),
        conditions={"pole error": placed.error, "size of K": gain_size(F, K, plant.C)},
        notes=(f"disturbances are not decoupled by a Luenberger observer: {names}",) if names else (),
        references=("Twardy and Kaczorek, part I, Theorem 2",),
    )
    made = Observer(plant, F, np.eye(n), K, np.eye(n), np.zeros(K.shape), W, evidence.method, False, evidence)
    evidence = evidence.extended(conditions={"estimate off the state": check_estimate(made)})
    return in_units_of_the_plant(replace(made, evidence=evidence), original, even)
