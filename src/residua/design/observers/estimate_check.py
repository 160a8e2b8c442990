"""Whether the estimate of a finished observer is the state, whatever the inputs do."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from residua.design.core.internal_form import frequency_grid
from residua.errors import AccuracyError, ModelError
from residua.linear import StateSpace
from residua.linear.systems.response_terms import in_even_units, response_terms
from residua.tolerances import RESPONSE_ROUNDING, TINY, above_rounding

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
    Y = p.C @ X + driven.D
    worst = _off(X, Y, observer.system.frequency_response(w), len(p.inputs))
    if not worst <= limit:
        states = StateSpace(
            p.A, driven.B, np.vstack([np.eye(p.n_states), p.C]), _below(driven.D, p.n_states), E=p.E, dt=p.dt
        )
        whole = _without_rounding(states, w)
        X, Y = whole[:, : p.n_states], whole[:, p.n_states :]
        worst = _off(X, Y, _without_rounding(observer.system, w), len(p.inputs))
    if not worst <= limit:
        raise AccuracyError(
            f"the estimate is off the state by {worst:.2g} (relative, limit {limit:.0e}): the measurements see "
            "part of the plant too weakly for the gain that this takes; ask for slower poles, a smaller margin, or "
            "add a sensor"
        )
    return worst


def _off(X: NDArray, Y: NDArray, Q: NDArray, n_u: int) -> float:
    """Return how far an estimate is from the state, by their responses and those of the outputs that are read."""
    direct = np.zeros_like(X)
    direct[:, :, :n_u] = Q[:, :, :n_u]
    off = np.abs(direct + Q[:, :, n_u:] @ Y - X).max(axis=0)
    terms = (np.abs(direct) + np.abs(Q[:, :, n_u:]) @ np.abs(Y) + np.abs(X)).max(axis=0)
    # an input that hardly reaches a state is judged by what others do to it: what rounding left of nothing is not off
    rows = np.maximum(terms.max(axis=1, keepdims=True), TINY)
    terms = np.maximum(terms, 1e-6 * rows * (terms / rows).max(axis=0))
    # nor is a path that is itself what rounding left of nothing, as that of a measurement that is not used
    paths = np.abs(Q[:, :, n_u:]).max(axis=(0, 2))[:, None] * np.abs(Y).max(axis=(0, 1))[None, :]
    terms = np.maximum(terms, 1e-9 * paths)
    return float(np.max(off / np.maximum(terms, TINY)))


def _without_rounding(system: StateSpace, w: NDArray) -> NDArray:
    """Return a frequency response, exactly zero where it is rounding of its terms or no chain of couplings leads.

    Of a state that nothing moves rounding is all that there is.
    """
    even = in_even_units(system)
    points = np.asarray(np.exp(1j * w * system.dt) if system.is_discrete else 1j * w, dtype=np.complex128)
    found = response_terms(even.system, points)
    return above_rounding(found.values, found.terms, RESPONSE_ROUNDING) / even.outputs[:, None] / even.inputs


def _below(D: NDArray, rows: int) -> NDArray[np.float64]:
    """Return a matrix below rows of zeros."""
    return np.vstack([np.zeros((rows, D.shape[1])), D])
