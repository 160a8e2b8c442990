"""Observability and controllability of descriptor systems."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.errors import AccuracyError
from residua.linear.poles.spectrum import describe_modes
from residua.linear.poles.zeros import invariant_zeros, pencil_rank_at
from residua.linear.subspaces.rank import DEFAULT_RTOL, RankDecision, decide_rank, equilibrated
from residua.linear.systems.descriptor import balanced_pencil, checked_pencil, weierstrass_form
from residua.linear.systems.scaling import scaling


@dataclass(frozen=True, eq=False)
class DescriptorProperty:
    """The observability or controllability of a descriptor system, and the condition that fails; a bool as a condition.

    Attributes
    ----------
    complete : bool
        C-observable: no finite mode is hidden, and the algebraic part is seen too. This is the truth value.
    finite : bool
        R-observable: no finite mode is hidden.
    impulse : bool
        Impulses of the state show in the output.
    hidden_modes : ndarray of complex
        The finite ``s`` at which the pencil loses rank.
    rank_finite : RankDecision
        Of the pencil at the first hidden mode; without one, at a point that is no special one.
    rank_infinite : RankDecision
        Of ``[E; C]``, respectively ``[E B]``.
    reasons : tuple of str
        What fails, in words and numbers; empty when nothing does.
    """

    complete: bool
    finite: bool
    impulse: bool
    hidden_modes: NDArray[np.complex128]
    rank_finite: RankDecision
    rank_infinite: RankDecision
    reasons: tuple[str, ...]

    def __bool__(self) -> bool:
        return self.complete

    def __str__(self) -> str:
        return "complete" if self.complete else "not complete: " + "; ".join(self.reasons)


def descriptor_observability(
    A: ArrayLike, C: ArrayLike, E: ArrayLike | None = None, *, rtol: float = DEFAULT_RTOL
) -> DescriptorProperty:
    r"""Tell whether the outputs of a descriptor system determine its whole state.

    C-observable exactly when

    .. math::

       \operatorname{rank} \begin{bmatrix} sE - A \\ C \end{bmatrix} = n \ \text{for every finite } s, \qquad
       \operatorname{rank} \begin{bmatrix} E \\ C \end{bmatrix} = n.

    The first condition alone is R-observability. Impulse observability is
    :math:`\operatorname{rank} [E\ A; 0\ E; 0\ C] = n + \operatorname{rank} E`.

    Parameters
    ----------
    A : array_like, shape (n, n)
    C : array_like, shape (p, n)
    E : array_like, shape (n, n), optional
        Identity when omitted.
    rtol : float
        For every rank decision, in scaled units.

    Returns
    -------
    DescriptorProperty

    Raises
    ------
    ModelError
        If a matrix is malformed or the pencil is not regular.
    AccuracyError
        If a rank decision was not clear.

    References
    ----------
    Twardy and Kaczorek, part I, Definition 4 and eqs. (28); L. Dai, Singular Control Systems, Springer 1989, chapter 2.

    Examples
    --------
    >>> observability = descriptor_observability([[1, 2], [3, 4]], [[1, 0]], [[1, 0], [0, 0]])
    >>> bool(observability), observability.finite, observability.reasons
    (False, True, ('rank[E; C] = 1 < 2: the outputs miss a part of the state that obeys algebraic equations alone',))
    """
    A, E = checked_pencil(A, E)
    C = arrays.matrix(C, "C", (None, len(A)), what="one column per state")
    return _property(A, E, C, rtol, "rank[sE - A; C]", "rank[E; C]", "outputs miss")


def descriptor_controllability(
    A: ArrayLike, B: ArrayLike, E: ArrayLike | None = None, *, rtol: float = DEFAULT_RTOL
) -> DescriptorProperty:
    r"""Tell whether the inputs of a descriptor system move its whole state.

    C-controllable exactly when :math:`\operatorname{rank} [sE - A\ B] = n` for every finite ``s`` and
    :math:`\operatorname{rank} [E\ B] = n`, which is what Lemma 4 says of the two parts of the Weierstrass form.

    Parameters
    ----------
    A : array_like, shape (n, n)
    B : array_like, shape (n, m)
    E : array_like, shape (n, n), optional
        Identity when omitted.
    rtol : float
        For every rank decision, in scaled units.

    Returns
    -------
    DescriptorProperty

    Raises
    ------
    ModelError
        If a matrix is malformed or the pencil is not regular.
    AccuracyError
        If a rank decision was not clear.

    References
    ----------
    Twardy and Kaczorek, part I, Definition 3 and Lemma 4, eqs. (17).

    Examples
    --------
    >>> bool(descriptor_controllability([[1, 2], [3, 4]], [[1], [1]], [[1, 0], [0, 0]]))
    True
    """
    A, E = checked_pencil(A, E)
    B = arrays.matrix(B, "B", (len(A), None), what="one row per state")
    return _property(A.T, E.T, B.T, rtol, "rank[sE - A, B]", "rank[E, B]", "inputs do not move")


def _property(
    A: NDArray, E: NDArray, C: NDArray, rtol: float, pencil: str, infinite: str, what: str
) -> DescriptorProperty:
    n, empty = len(A), np.zeros((len(A), 0))
    poles = weierstrass_form(A, E, rtol=rtol).poles  # raises when the pencil is not regular
    hidden = invariant_zeros(A, empty, C, None, E).zeros
    # Poles at zero have no size; the unit of s in which A and E are comparable stands in.
    size = np.abs(poles).max(initial=balanced_pencil(A, E).unit)
    if not np.all(np.abs(hidden[:, None] - poles).min(axis=1, initial=np.inf) <= 1e-3 * size):
        raise AccuracyError(
            f"the hidden modes {describe_modes(hidden)} are not among the poles {describe_modes(poles)}: a rank "
            f"decision with rtol={rtol:.3g} was not clear; choose another rtol, or rescale the model"
        )
    at = complex(hidden[0]) if hidden.size else 0.77 * max(1e-3, float(np.abs(poles).max(initial=1.0)))
    rank_finite = pencil_rank_at(A, empty, C, None, E, at, rtol=1e-7 if hidden.size else rtol)
    units = scaling(A, empty, C, np.zeros((len(C), 0)), E, sampled=False)
    R, X = units.equations[:, None], units.states
    A, E, C = R * A * X / units.rate, R * E * X, units.outputs[:, None] * C * X
    rank_infinite = decide_rank(equilibrated(np.vstack([E, C])), rtol=rtol)
    reasons = []
    if hidden.size:
        reasons.append(f"{pencil} = {rank_finite.rank} < {n} at s = {describe_modes(hidden)}: the {what} this mode")
    if rank_infinite.rank < n:
        reasons.append(
            f"{infinite} = {rank_infinite.rank} < {n}: the {what} a part of the state that obeys algebraic "
            "equations alone"
        )
    whole = np.block([[E, A], [np.zeros_like(E), E], [np.zeros_like(C), C]])
    impulse = decide_rank(whole, rtol=rtol).rank == n + decide_rank(E, rtol=rtol).rank
    return DescriptorProperty(not reasons, not hidden.size, impulse, hidden, rank_finite, rank_infinite, tuple(reasons))
