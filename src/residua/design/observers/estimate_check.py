"""Whether the estimate of a finished observer is the state, whatever the inputs do."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from residua.design.core.internal_form import frequency_grid
from residua.errors import AccuracyError, ModelError
from residua.linear import StateSpace
from residua.tolerances import TINY

if TYPE_CHECKING:
    from residua.design.observers.observer import Observer


def check_estimate(observer: Observer, *, limit: float = 3e-7) -> float:
    r"""Return how far the response of the estimate to the inputs is from that of the state, or raise.

    The identities of an observer are local: in coordinates in which ``F`` is far from normal, rounding of its entries
    moves the estimate by much more than the identities are missed. So the response to controls, and to the
    disturbances that are decoupled, is compared with that of the state over frequency, relative to the terms that
    make up the difference.

    Parameters
    ----------
    observer : Observer
    limit : float

    Returns
    -------
    float
        Zero where the pencil of the plant is not regular: then there is no response to compare with.

    Raises
    ------
    AccuracyError
        If the difference is larger than the limit.
    """
    p = observer.plant
    driven = p.system(("control", "disturbance") if observer.decouples else ("control",))
    if not p.n_states or not driven.n_inputs:
        return 0.0
    w = frequency_grid(driven, observer.system, points=24)
    try:
        X = StateSpace(p.A, driven.B, np.eye(p.n_states), E=p.E, dt=p.dt).frequency_response(w)
    except ModelError:
        return 0.0
    n_u = len(p.inputs)
    Q = observer.system.frequency_response(w)
    direct = np.zeros_like(X)
    direct[:, :, :n_u] = Q[:, :, :n_u]
    Y = p.C @ X + driven.D
    off = np.abs(direct + Q[:, :, n_u:] @ Y - X).max(axis=0)
    terms = (np.abs(direct) + np.abs(Q[:, :, n_u:]) @ np.abs(Y) + np.abs(X)).max(axis=0)
    # an input that hardly reaches a state is judged by what others do to it: what rounding left of nothing is not off
    rows = np.maximum(terms.max(axis=1, keepdims=True), TINY)
    terms = np.maximum(terms, 1e-6 * rows * (terms / rows).max(axis=0))
    # nor is a path that is itself what rounding left of nothing, as that of a measurement that is not used
    paths = np.abs(Q[:, :, n_u:]).max(axis=(0, 2))[:, None] * np.abs(Y).max(axis=(0, 1))[None, :]
    terms = np.maximum(terms, 1e-9 * paths)
    worst = float(np.max(off / np.maximum(terms, TINY)))
    if not worst <= limit:
        raise AccuracyError(
            f"the estimate is off the state by {worst:.2g} (relative, limit {limit:.0e}): the measurements see "
            "part of the plant too weakly for the gain that this takes; ask for slower poles, a smaller margin, or "
            "add a sensor"
        )
    return worst
