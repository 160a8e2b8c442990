"""Luenberger's observer: full order, nothing decoupled."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from residua import arrays
from residua.design.core.evidence import Evidence
from residua.design.core.method import method
from residua.design.observers.observer import Observer, balanced_observer, with_checked_estimate
from residua.design.observers.observer_gain import asked, default_weights, pair_gain, require_detectable, with_gain
from residua.errors import DesignError
from residua.plant import Plant
from residua.plant.balanced import is_singular


@method(
    exists_when="(C, A) detectable",
    order="n",
    source="Twardy and Kaczorek, part I, Theorems 1 and 2",
    state="estimate, converges",
)
def luenberger_observer(
    plant: Plant,
    *,
    poles: Sequence[complex] | ArrayLike | None = None,
    margin: float | None = None,
    outputs: Iterable[str | int] | str | None = None,
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
        Decay rate in 1/s that every pole must have at least, used without ``poles``. When omitted too, the gain is that
        of least squares with equal noise in all states and outputs of the balanced plant: poles are as slow as the
        plant where it is hardly seen.
    outputs : sequence of str, optional
        The measurements that drive the observer, all when omitted. The residual is the error of these.

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
    plant = plant.explicit()
    model = plant.balanced
    require_detectable(model, used)
    process, measurement = default_weights(model)
    gain = pair_gain(
        model, model.A, model.C[used], (process, measurement[np.ix_(used, used)]), *asked(model.plant, poles, margin)
    )
    names = ", ".join(plant.disturbances)
    evidence = Evidence(
        method="Luenberger observer",
        notes=(f"disturbances are not decoupled by a Luenberger observer: {names}",) if names else (),
        references=("Twardy and Kaczorek, part I, Theorem 2",),
    )
    return with_checked_estimate(balanced_observer(model, gain.K, with_gain(evidence, gain, model), used))
