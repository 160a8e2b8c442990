"""Algebraic equations of a plant: their exact elimination, if the index allows it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.arrays import frozen
from residua.errors import AccuracyError, ModelError
from residua.linear.subspaces.rank import DEFAULT_RTOL
from residua.linear.systems.descriptor import ScaledPencil, balanced_pencil, pencil_decision, weierstrass_form
from residua.plant.channels import ROLES
from residua.tolerances import IDENTITY, ROUNDING, TINY, above_rounding

if TYPE_CHECKING:
    from residua.plant.plant import Plant


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
    p = balanced_pencil(plant.A, plant.E)
    U, s, _ = np.linalg.svd(p.E)
    r = int(np.count_nonzero(s > rtol * s[0])) if s.size else 0
    if r == plant.n_states:
        return plant
    E1, A2 = U[:, :r].T @ p.E, U[:, r:].T @ p.A
    whole = np.vstack([E1, A2])
    _check_index(plant, p, whole, rtol)
    inverse = np.linalg.inv(whole)
    # rounding of zeros would be a way from an input to an output that the equations do not have
    inverse = above_rounding(inverse, float(np.abs(inverse).max(initial=0.0)))
    return _reduced(plant, p, U, r, inverse, E1)


def _check_index(plant: Plant, p: ScaledPencil, whole: NDArray, rtol: float) -> None:
    values = np.linalg.svd(whole, compute_uv=False)
    if values[-1] > rtol * values[0]:
        return
    if pencil_decision(p, rtol).rank < plant.n_states:
        raise ModelError(
            "det(sE - A) is zero for every s: the equations do not determine the states; remove redundant ones, add "
            "missing ones"
        )
    index = weierstrass_form(plant.A, plant.E, rtol=rtol).index
    what = "later inputs" if plant.is_discrete else "derivatives of its inputs, and held inputs would give it impulses"
    raise ModelError(
        f"the algebraic equations cannot be eliminated: the plant has index {index} > 1, so that its state depends on "
        f"{what}; differentiate the constraint in the model, or use a perfect observer (residua.design)"
    )


def _reduced(plant: Plant, p: ScaledPencil, U: NDArray, r: int, inverse: NDArray, E1: NDArray) -> Plant:
    n, letters = plant.n_states, tuple(ROLES.values())
    widths = np.cumsum([getattr(plant, "B" + x).shape[1] for x in letters])[:-1]
    B = p.rows[:, None] * np.hstack([getattr(plant, "B" + x) for x in letters])
    D = np.hstack([getattr(plant, "D" + x) for x in letters])
    X1, direct = inverse[:, :r], -inverse[:, r:] @ (U[:, r:].T @ B)
    # z = E1 x; with S the chosen rows of the state, x_S = (X1)_S z.
    chosen, basis = _kept_states(p, X1, inverse[:, r:], U[:, r:].T @ B)
    A_z, B_z = U[:, :r].T @ p.A @ X1, U[:, :r].T @ (p.A @ direct + B)
    back = np.linalg.inv(basis)
    # The pencil was scaled for s / unit, so the unit comes back as a factor of the rates.
    A = p.unit * basis @ A_z @ back
    B_r = p.unit * basis @ B_z
    units = np.array([p.columns[i] if i is not None else 1.0 for i in chosen])
    to_states = p.columns[:, None] * (X1 @ back) / units
    A, B_r = units[:, None] * A / units, units[:, None] * B_r
    direct = p.columns[:, None] * direct
    floors = _cancelled(p, U, r, inverse, basis, back, B)
    # The columns of both identities are in the units of the new states, and of the inputs.
    floors = floors[0] / p.rows[:, None] / units, floors[1] / p.rows[:, None]
    whole_B = np.hstack([getattr(plant, "B" + x) for x in letters])
    _check_elimination(plant, to_states, direct, A, B_r, whole_B, floors)
    C, D = plant.C @ to_states, D + plant.C @ direct
    names = _names(plant, chosen, n)
    fields: dict[str, object] = {"A": frozen(A), "E": None, "C": frozen(C), "states": names}
    for x, Bx, Dx in zip(letters, np.hsplit(B_r, widths), np.hsplit(D, widths), strict=True):
        fields["B" + x], fields["D" + x] = frozen(Bx), frozen(Dx)
    known = {*plant.inputs, *plant.outputs, *names}
    fields["units"] = {key: unit for key, unit in plant.units.items() if key in known}
    return plant._with(**fields)


def _kept_states(p: ScaledPencil, X1: NDArray, X2: NDArray, B2: NDArray) -> tuple[list[int | None], NDArray]:
    """Return the old states that become new ones (None: a new direction) and their rows of ``z``."""
    r = X1.shape[1]
    terms = np.abs(X2) @ np.abs(B2)
    # A state that an input reaches at once is not a function of z, and has no useful derivative.
    free = np.flatnonzero(
        np.abs(X2 @ B2).max(axis=1, initial=0.0) <= ROUNDING * np.maximum(terms.max(initial=0.0), TINY)
    )
    own = [i for i in free if np.any(p.E[:, i])]
    rows = X1[own]
    if not len(own) or not r:
        return [None] * r, np.eye(r)
    R, pivots = scipy.linalg.qr(rows.T, mode="r", pivoting=True)
    size = np.abs(np.diag(R))
    count = int(np.count_nonzero(size > 1e-6 * size[0]))
    chosen = sorted(own[i] for i in pivots[:count])
    basis = X1[chosen]
    rest = scipy.linalg.null_space(basis).T[: r - count] if count < r else np.zeros((0, r))
    return [*chosen, *([None] * (r - count))], np.vstack([basis, rest])


def _cancelled(
    p: ScaledPencil, U: NDArray, r: int, inverse: NDArray, basis: NDArray, back: NDArray, B: NDArray
) -> tuple[NDArray, NDArray]:
    """Return the sizes of the terms of both identities; rows that cancel leave the rounding of these."""
    size = np.full_like(inverse, np.abs(inverse).max(initial=0.0))
    X, left = size[:, :r] @ np.abs(back), np.abs(basis) @ np.abs(U[:, :r].T)
    direct = size[:, r:] @ np.abs(U[:, r:].T) @ np.abs(B)
    AX, AB = np.abs(p.A) @ X, np.abs(p.A) @ direct + np.abs(B)
    EX = np.abs(p.E) @ X
    return EX @ left @ AX + AX, EX @ left @ AB + AB


def _names(plant: Plant, chosen: list[int | None], n: int) -> tuple[str, ...]:
    taken = {plant.states[i] for i in chosen if i is not None}
    fresh = (f"slow {k}" for k in range(1, 2 * n + 2) if f"slow {k}" not in taken)
    return tuple(next(fresh) if i is None else plant.states[i] for i in chosen)


def _check_elimination(
    plant: Plant,
    X: NDArray,
    direct: NDArray,
    A: NDArray,
    B: NDArray,
    whole_B: NDArray,
    floors: tuple[NDArray, NDArray],
    limit: float = IDENTITY,
) -> None:
    """Check ``E X A = A X`` and ``E X B = A direct + B``, each relative to its terms.

    At least 1e-4 of ``floors`` counts, which are the terms before they cancelled.
    """
    E = plant.E
    assert E is not None
    worst = 0.0
    for floor, left, right, terms in (
        (floors[0], E @ X @ A, plant.A @ X, np.abs(E) @ np.abs(X) @ np.abs(A) + np.abs(plant.A) @ np.abs(X)),
        (
            floors[1],
            E @ X @ B,
            plant.A @ direct + whole_B,
            np.abs(E) @ np.abs(X) @ np.abs(B) + np.abs(plant.A) @ np.abs(direct) + np.abs(whole_B),
        ),
    ):
        rows = np.maximum(terms, 1e-4 * floor).max(axis=1, keepdims=True, initial=0.0)
        worst = max(worst, float(np.max(np.abs(left - right) / np.where(rows > 0, rows, 1.0), initial=0.0)))
    if not worst <= limit:
        raise AccuracyError(
            f"eliminating the algebraic equations misses the plant's own by {worst:.2g} > {limit:.0e}: they are nearly "
            "of index 2; rescale the model, or drop its fastest dynamics"
        )
