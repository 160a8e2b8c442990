"""Algebraic equations of a plant: their exact elimination, if the index allows it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.arrays import frozen
from residua.errors import ModelError
from residua.linear.subspaces.rank import DEFAULT_RTOL
from residua.linear.systems.descriptor import weierstrass_form
from residua.plant.channels import ROLES
from residua.plant.observer_form import check_response, response_error, response_points, state_terms
from residua.tolerances import ROUNDING, TINY, above_rounding

if TYPE_CHECKING:
    from residua.plant.plant import Plant

#: A state of which less than this part is independent of others is none of the new ones.
_DISTINCT = 1e-6
#: Largest error of the frequency response.
_EXACT = 1e-6


def without_algebraic_equations(plant: Plant, *, rtol: float = DEFAULT_RTOL) -> Plant:
    r"""Return the same plant without its algebraic equations: of lower order, with an invertible ``E``.

    With :math:`U^T E = [E_1; 0]`, the rows of :math:`U^T` below give :math:`0 = A_2 x + B_2 v`. For index 1
    :math:`[E_1; A_2]` is invertible, so :math:`z = E_1 x` determines the state,
    :math:`x = X_1 z - X_2 B_2 v`, and obeys :math:`\dot z = A_1 x + B_1 v`. Transfer functions from every
    input, faults and noise included, are unchanged. Wherever enough of the old states are functions of ``z`` alone
    they become the new states, with their names and units; others are called ``slow 1``, ``slow 2``, ...

    Parameters
    ----------
    plant : Plant
        Continuous or sampled. One with an invertible ``E`` is returned as it is.
    rtol : float
        For every rank decision, in scaled units.

    Returns
    -------
    Plant
        With ``n1 = rank E`` states. What entered an algebraic equation enters the outputs directly.

    Raises
    ------
    ModelError
        If the pencil is not regular, or its index is 2 or more: the state then depends on derivatives of the inputs
        (sampled: on later inputs), which no such plant has.
    AccuracyError
        If the elimination is too badly conditioned.

    References
    ----------
    Twardy and Kaczorek, part I, eqs. (15), (16), for ``N = 0``.

    Examples
    --------
    >>> import residua as rs
    >>> from residua.plant import without_algebraic_equations
    >>> plant = rs.Plant([[-1, 1], [1, -2]], [[0], [1]], [[0, 1]], E=[[1, 0], [0, 0]], states=["level", "flow"])
    >>> small = without_algebraic_equations(plant)
    >>> small.states, small.A, small.D
    (('level',), array([[-0.5]]), array([[0.5]]))
    """
    if plant.E is None:
        return plant
    model = plant.balanced
    rate, rows, columns = model.units.rate, model.units.equations[:, None], model.units.states
    k = len(model.A)
    if k == plant.n_states:
        return plant
    # x = V1 xi + V2 v with the equations 0 = algebra (A x + B u): v follows from xi and u where that can be solved
    A, _, E = model.written
    V1, V2 = model.back[:, :k], model.back[:, k:]
    solved = model.algebra @ A @ V2
    sizes = np.linalg.svd(solved, compute_uv=False)
    if not sizes[-1] > rtol * sizes[0]:
        index = weierstrass_form(plant.A, plant.E, rtol=rtol).index
        what = "later inputs" if plant.is_discrete else "derivatives of its inputs; held inputs would give it impulses"
        raise ModelError(
            f"the algebraic equations cannot be eliminated: the plant has index {index} > 1, so that its state depends "
            f"on {what}; differentiate the constraint in the model, or use a perfect observer (residua.design)"
        )
    P = V2 @ np.linalg.inv(solved) @ model.algebra
    # rounding of zeros would be a way from an input to an output that the equations do not have
    P, X = (above_rounding(M, float(np.abs(M).max(initial=0.0))) for M in (P, V1 - P @ A @ V1))
    letters = tuple(ROLES.values())
    B = rows * np.hstack([getattr(plant, "B" + letter) for letter in letters]) / rate
    D = np.hstack([getattr(plant, "D" + letter) for letter in letters])
    direct = -P @ B
    chosen, basis = _kept_states(E, X, direct, np.abs(P) @ np.abs(B))
    back = np.linalg.inv(basis)
    units = np.array([columns[i] if i is not None else 1.0 for i in chosen])
    onto = rate * units[:, None] * basis @ model.derivative
    A, B = onto @ A @ (X @ back / units), onto @ (A @ direct + B)
    C, D = plant.C @ (columns[:, None] * (X @ back / units)), D + plant.C @ (columns[:, None] * direct)
    taken = {plant.states[i] for i in chosen if i is not None}
    fresh = (f"slow {j}" for j in range(1, 2 * plant.n_states + 2) if f"slow {j}" not in taken)
    names = tuple(next(fresh) if i is None else plant.states[i] for i in chosen)
    fields: dict[str, object] = {"A": frozen(A), "E": None, "C": frozen(C), "states": names}
    widths = np.cumsum([getattr(plant, "B" + letter).shape[1] for letter in letters])[:-1]
    for letter, Bx, Dx in zip(letters, np.hsplit(B, widths), np.hsplit(D, widths), strict=True):
        fields["B" + letter], fields["D" + letter] = frozen(Bx), frozen(Dx)
    known = {*plant.inputs, *plant.outputs, *names}
    small = plant._with(**fields, units={key: unit for key, unit in plant.units.items() if key in known})
    system = small.system()
    points = response_points(np.append(system.poles(), rate), plant.dt, count=20)  # the rate: integrators have none
    error = response_error(system.evaluate(points), plant.system().evaluate(points), state_terms(system, points))
    check_response(
        error,
        _EXACT,
        "the plant without its algebraic equations",
        "they are nearly of index 2; rescale the model, or drop its fastest dynamics",
    )
    return small


def _kept_states(E: NDArray, X: NDArray, direct: NDArray, terms: NDArray) -> tuple[list[int | None], NDArray]:
    """Return the old states that become new ones (None: a new direction) and their rows of ``xi``."""
    r = X.shape[1]
    # A state that an input reaches at once is not a function of xi, and has no useful derivative.
    reached = np.abs(direct).max(axis=1, initial=0.0) > ROUNDING * np.maximum(terms.max(initial=0.0), TINY)
    candidates = [i for i in np.flatnonzero(~reached) if np.any(E[:, i])]
    if not len(candidates) or not r:
        return [None] * r, np.eye(r)
    R, pivots = scipy.linalg.qr(X[candidates].T, mode="r", pivoting=True)
    size = np.abs(np.diag(R))
    count = int(np.count_nonzero(size > _DISTINCT * size[0]))
    chosen = sorted(candidates[i] for i in pivots[:count])
    rest = scipy.linalg.null_space(X[chosen]).T[: r - count] if count < r else np.zeros((0, r))
    return [*chosen, *([None] * (r - count))], np.vstack([X[chosen], rest])
