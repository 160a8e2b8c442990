"""Chow and Willsky's parity relations: all of an order, or the shortest."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from residua import arrays
from residua.design.core.generator import ResidualGenerator
from residua.design.core.method import method
from residua.design.parity.relation_model import relation_model
from residua.design.parity.relations import Poles, relations_of
from residua.design.parity.shortest import relation_space, shortest_space, with_rank
from residua.errors import AccuracyError, DesignError, SettingError
from residua.linear.polynomials.pair_relations import PairRelations
from residua.plant import Plant
from residua.plant.input_output_model import InputOutputModel
from residua.tolerances import BALANCED_RANK, NEAR

#: States of the filters of all relations of an order together, beyond which a design takes many seconds.
_MOST_STATES = 300


@method(
    exists_when="as decoupled_residual",
    order="sum of the orders of the relations",
    source="Chow and Willsky (1984); Gertler (1991), eqs. (3-5) to (3-10), section 4.2",
    decouples=True,
    singular=True,
    noise="moving average",
)
def parity_relations(
    plant: Plant | InputOutputModel,
    *,
    order: int | None = None,
    insensitive_to: Iterable[str | int] | str = (),
    outputs: Iterable[str | int] | str | None = None,
    poles: Poles | None = None,
) -> ResidualGenerator:
    r"""Design residuals from the last samples of inputs and outputs alone.

    Over ``n' + 1`` samples the outputs are :math:`Y = R x + Q U`; every vector with

    .. math:: w^T R = 0, \qquad w^T Q_{\text{ignored}} = 0

    is a relation :math:`r^* = w^T (Y - Q U)` of order ``n'`` that no state, no disturbance and no ignored fault
    enters. The search keeps the states as unknowns, ``p (zE - A) = q C``, so that no power of ``A`` is formed.

    Guaranteed (and checked): zero while nothing fails, for any state and any input; the result has all relations
    of the order, as independent ones.

    Parameters
    ----------
    plant : Plant or InputOutputModel
        Continuous or sampled; ``E`` may be singular.
    order : int, optional
        ``n'``: all independent relations of at most this order. The smallest at which there is one when omitted; those
        of that order are then returned.
    insensitive_to : sequence of str
        Faults to ignore, besides all disturbances.
    outputs : sequence of str, optional
        The outputs that relations may read; all when omitted. See :func:`parity_orders` for the smallest orders.
    poles : sequence of complex, or mapping of str to sequence, optional
        See :meth:`ParityRelations.with_poles`. When omitted the residuals are the moving averages themselves, and in
        continuous time all poles lie at the rate of the plant; those of a gain by least squares where more than six
        digits cancel so.

    Returns
    -------
    ResidualGenerator
        Its ``relations`` hold the polynomials and print as equations.

    Raises
    ------
    DesignError
        If there is no such relation (of that order).
    AccuracyError
        If the coefficients miss the states, or known inputs reach the residual.

    See Also
    --------
    decoupled_residual : The same as a filter, which noise harms less.
    structured_parity : One relation per row of a structure.
    primary_residuals : The equations of the model.
    optimal_parity : Where disturbances cannot be decoupled.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant.

    References
    ----------
    Chow and Willsky (1984), IEEE TAC 29(7); Gertler (1991), eqs. (3-5) to (3-10), section 4.2.

    Examples
    --------
    >>> import residua as rs
    >>> flt = rs.design.parity_relations(rs.library.gertler(), insensitive_to="p1")
    >>> print(flt.relations)
    r1 = y1[k] - 1.3 y1[k-1] + 0.36 y1[k-2] - 2 y2[k] + 2.7 y2[k-1] - 0.81 y2[k-2] + 0.7 u1[k-1] - 0.54 u1[k-2]
    """
    model = relation_model(plant)
    ignored = [model.plant.faults[i] for i in arrays.positions(insensitive_to, model.plant.faults, "fault")]
    chosen = model.reading(outputs)
    equations, C = chosen.equations(ignored), model.plant.C
    if order is not None and (states := _whole(order) * max((order + 1) * len(C) - C.shape[1], 1)) > _MOST_STATES:
        raise SettingError(
            f"order {order} means up to {states} states of filters, the most is {_MOST_STATES}; above the "
            f"{C.shape[1]} states of the plant relations are shifted copies of shorter ones: ask for a lower order"
        )
    what = ", ".join(f"'{name}'" for name in (*model.plant.disturbances, *ignored)) or "nothing"
    if equations.orders is None:
        raise DesignError(
            f"no parity relation ignores {what}: the measurements are all used up; add a sensor, read more outputs or "
            "ignore less"
        )
    if order is not None and order < equations.orders[0]:
        raise DesignError(f"no relation of order {order} ignores {what}: the smallest order is {equations.orders[0]}")
    notes = (*model.notes, *((f"ignores {', '.join(ignored)}",) if ignored else ()))

    def design(used: PairRelations) -> ResidualGenerator:
        if order is None:
            space = shortest_space(chosen, used)
        else:
            space = relation_space(used, order, chosen.balanced.faults)
        generator = relations_of(model.plant, space.relations).with_poles(poles, notes=notes)
        return with_rank(generator, space, equations.near)

    try:
        return design(equations)
    except AccuracyError:  # where a rank is hardly decided, shorter relations may hold to working precision
        near = chosen.equations(ignored, tolerance=NEAR * BALANCED_RANK)
        if order is not None or not equations.near or near.orders is None:
            raise
        return design(near)


def parity_orders(
    plant: Plant | InputOutputModel,
    *,
    insensitive_to: Iterable[str | int] | str = (),
    most_outputs: int | None = None,
) -> dict[tuple[str, ...], int]:
    """Return for each set of outputs the order of the shortest relation that reads no others.

    Parameters
    ----------
    plant : Plant or InputOutputModel
    insensitive_to : sequence of str
        Faults to ignore, besides all disturbances.
    most_outputs : int, optional
        The largest sets to look at; all when omitted.

    Returns
    -------
    dict of tuple of str to int
        Sets without any relation are left out.

    Raises
    ------
    SettingError
        If there are more than 1000 sets.

    References
    ----------
    Gertler (1991), section 3.2.

    Examples
    --------
    >>> import residua as rs
    >>> rs.design.parity_orders(rs.library.gertler())
    {('y1',): 2, ('y2',): 2, ('y1', 'y2'): 1}
    """
    model = relation_model(plant)
    names = model.plant.outputs
    ignored = [model.plant.faults[i] for i in arrays.positions(insensitive_to, model.plant.faults, "fault")]
    most = len(names) if most_outputs is None else int(most_outputs)
    if most < 1:
        raise SettingError(f"most_outputs must be 1 at least, got {most_outputs!r}")
    count = sum(comb(len(names), size) for size in range(1, most + 1))
    if count > 1000:
        raise SettingError(
            f"{len(names)} outputs have {count} sets of up to {most}: limit their size with most_outputs"
        )
    sets = [chosen for size in range(1, most + 1) for chosen in combinations(names, size)]
    orders = {chosen: model.reading(chosen).equations(ignored).orders for chosen in sets}
    return {chosen: found[0] for chosen, found in orders.items() if found is not None}


def chow_willsky_matrices(plant: Plant, order: int) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    r"""Return the matrices of :math:`Y(t) = R x(t - n') + Q_u U + Q_f F + Q_d D` over ``order + 1`` samples.

    Parameters
    ----------
    plant : Plant
        Without ``E``. In continuous time the samples are derivatives, the lowest first.
    order : int
        ``n'``.

    Returns
    -------
    R : ndarray, shape ((order + 1) outputs, states)
    Q : dict of str to ndarray, shape ((order + 1) outputs, (order + 1) signals)
        For ``"control"``, ``"fault"`` and ``"disturbance"``; the oldest sample first.

    Raises
    ------
    DesignError
        If the plant has an ``E``.
    SettingError
        If the order is no whole number.

    References
    ----------
    Gertler (1991), eqs. (3-7), (3-8).
    """
    if plant.E is not None:
        raise DesignError("R and Q are made of powers of A: write the plant without E first (plant.explicit())")
    order = _whole(order)
    m, powers = plant.n_outputs, [plant.C]
    for _ in range(order):
        powers.append(powers[-1] @ plant.A)
    Q = {}
    for role, B, D in (
        ("control", plant.B, plant.D),
        ("fault", plant.Bf, plant.Df),
        ("disturbance", plant.Bd, plant.Dd),
    ):
        k = B.shape[1]
        response = [D, *(power @ B for power in powers[:-1])]
        whole = np.zeros(((order + 1) * m, (order + 1) * k))
        for i in range(order + 1):
            for j in range(i + 1):
                whole[i * m : (i + 1) * m, j * k : (j + 1) * k] = response[i - j]
        Q[role] = whole
    return np.vstack(powers), Q


def _whole(order: int) -> int:
    """Return an order, checked."""
    if isinstance(order, bool) or not isinstance(order, (int, np.integer)) or order < 0:
        raise SettingError(f"order must be a whole number of past samples, got {order!r}")
    return int(order)
