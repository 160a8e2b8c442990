"""The observability staircase: what the outputs see of the state, and what they never will."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.errors import AccuracyError
from residua.linear.poles.stability import dies_out, hidden_modes, is_stable_mode
from residua.linear.poles.zero_structure import scatter_of
from residua.linear.subspaces.quotient import observable_split, without_rounding
from residua.linear.subspaces.rank import RankDecision, spectral_norm
from residua.linear.systems.scaling import scaling
from residua.linear.systems.state_space import StateSpace

_EPS = float(np.finfo(float).eps)
#: How much of ``norm(A)`` the staircase may drop in the caller's coordinates before it is called a failure.
_MOST_DROPPED = 1e-5


@dataclass(frozen=True, eq=False)
class ObservabilityForm:
    """An observable part and an unobservable rest, in orthogonal coordinates ``z = Q' x``.

    Attributes
    ----------
    transformation : ndarray, shape (n, n)
        ``Q``, orthogonal: ``A = Q' A0 Q = [[A11, 0], [A21, A22]]``, ``C = C0 Q = [C1, 0]``.
    A, C : ndarray
        The matrices in the new coordinates, with exact zeros where the form has zeros.
    n_observable : int
        Order of ``A11``.
    decisions : tuple of RankDecision
        One for each step of the staircase, taken in balanced units.
    unobservable_modes : ndarray of complex
        Eigenvalues of ``A22``, computed in balanced units.
    mode_uncertainty : ndarray
        A bound, to first order, on the error of each unobservable mode.
    residual : float
        Largest norm of what was set to zero, relative to the norm of ``A0`` or ``C0``.
    size : float
        Spectral norm of ``A0`` in balanced units.
    """

    transformation: NDArray[np.float64]
    A: NDArray[np.float64]
    C: NDArray[np.float64]
    n_observable: int
    decisions: tuple[RankDecision, ...]
    unobservable_modes: NDArray[np.complex128]
    mode_uncertainty: NDArray[np.float64]
    residual: float
    size: float


@dataclass(frozen=True, eq=False)
class Detectability:
    """The decay of the modes that the outputs do not see; true as a condition where all die out by themselves.

    Attributes
    ----------
    detectable : bool
    unobservable_modes, unstable_modes : ndarray of complex
        All unobservable modes, and those of them that are not stable (the boundary counts as unstable).
    size : float
        Spectral norm of ``A`` in balanced units.
    near : tuple of RankDecision
        Rank decisions that double precision hardly allows; empty where all are clear.
    undecided : bool
        Whether all unstable modes may be stable: rounding may have scattered them from one place across the boundary.
    """

    detectable: bool
    unobservable_modes: NDArray[np.complex128]
    unstable_modes: NDArray[np.complex128]
    size: float
    near: tuple[RankDecision, ...] = ()
    undecided: bool = False

    def __bool__(self) -> bool:
        return self.detectable


@dataclass(frozen=True, eq=False)
class Staircase:
    """The observable part and the rest in balanced units, ``As = T^-1 A T``, ``Cs = Y C T``.

    Attributes
    ----------
    A, C : ndarray
        ``As`` and ``Cs``.
    Q : ndarray, shape (n, n)
        Orthogonal; its first ``n_observable`` columns are seen: ``Q' As Q = [[A11, 0], [A21, A22]]`` up to rounding.
    n_observable : int
    decisions : tuple of RankDecision
    states, outputs : ndarray
        ``T`` and ``Y``.
    rate : float
        A rate that suits the pair.
    size : float
        Spectral norm of ``As``.
    hidden_modes : tuple of ndarray
        The modes of the hidden part, and what rounding and dropped couplings may have done to each.
    """

    A: NDArray[np.float64]
    C: NDArray[np.float64]
    Q: NDArray[np.float64]
    n_observable: int
    decisions: tuple[RankDecision, ...]
    states: NDArray[np.float64]
    outputs: NDArray[np.float64]
    rate: float
    size: float
    hidden_modes: tuple[NDArray[np.complex128], NDArray[np.float64]]


def staircase(A: NDArray[np.float64], C: NDArray[np.float64]) -> Staircase:
    """Split a pair in balanced units into what the outputs see and the rest."""
    n, p = A.shape[0], C.shape[0]
    units = scaling(A, np.zeros((n, 0)), C, np.zeros((p, 0)), sampled=False)
    T, Y = units.states, units.outputs
    A, C = A / T[:, None] * T, Y[:, None] * C * T
    split = observable_split(A / units.rate, C)
    k, hidden, size = split.seen.shape[1], split.hidden, spectral_norm(A)
    # relative to the whole, not to the hidden block
    dropped = max(spectral_norm(split.seen.T @ A @ hidden), spectral_norm(C @ hidden)) + 10 * n * _EPS * size
    Q = np.hstack([split.seen, hidden])
    modes = hidden_modes(A, Q, k, dropped)
    return Staircase(A, C, Q, k, tuple(split.decisions), T, Y, units.rate, size, modes)


def observability_form(A: ArrayLike, C: ArrayLike) -> ObservabilityForm:
    r"""Split a pair orthogonally into its observable part and the rest.

    .. math:: Q^T A Q = \begin{bmatrix} A_{11} & 0 \\ A_{21} & A_{22} \end{bmatrix}, \qquad
              C Q = \begin{bmatrix} C_1 & 0 \end{bmatrix}

    with :math:`(A_{11}, C_1)` observable. Ranks are decided in balanced units, so that they do not depend on those
    of the states and outputs; what has to be dropped in the caller's units is checked and reported.

    Parameters
    ----------
    A : array_like, shape (n, n)
    C : array_like, shape (p, n)

    Returns
    -------
    ObservabilityForm

    Raises
    ------
    ModelError
        If a matrix is malformed.
    AccuracyError
        If the zeros of the form are not there to 1e-5 of the norm in the caller's units.

    References
    ----------
    Van Dooren, The generalized eigenstructure problem in linear system theory, IEEE TAC 26 (1981).

    Examples
    --------
    >>> form = observability_form([[-1.0, 0.0], [0.0, -2.0]], [[1.0, 0.0]])
    >>> form.n_observable, form.unobservable_modes
    (1, array([-2.+0.j]))
    """
    A, C = pair(A, C)
    form = staircase(A, C)
    k, Q = form.n_observable, form.Q
    if 0 < k < len(A) and np.any(form.states != 1):
        # Sorted rows and pivoted columns keep the small rows of a badly scaled basis accurate.
        N = form.states[:, None] * without_rounding(Q[:, k:])
        order = np.argsort(-np.abs(N).max(axis=1), kind="stable")
        Q = np.roll(scipy.linalg.qr(N[order], pivoting=True)[0], k, axis=1)[np.argsort(order)]
    At, Ct = Q.T @ A @ Q, C @ Q
    whole = np.linalg.norm(A), np.linalg.norm(C)
    residual = max(
        float(np.linalg.norm(M)) / (float(size) or 1.0) for M, size in zip((At[:k, k:], Ct[:, k:]), whole, strict=True)
    )
    if residual > _MOST_DROPPED:
        raise AccuracyError(
            f"the observability form drops {residual:.3g} of the norm of (A, C); scale the states to comparable units"
        )
    At[:k, k:] = 0.0
    Ct[:, k:] = 0.0
    modes, uncertainty = form.hidden_modes
    return ObservabilityForm(Q, At, Ct, k, form.decisions, modes, uncertainty, residual, form.size)


def without_unobservable(system: StateSpace) -> StateSpace:
    """Return the system without the states that no output sees; its transfer matrix is unchanged.

    The kept states are an orthonormal basis, in balanced units, of the observable quotient, so that hidden
    unstable modes go away without being cancelled numerically.
    """
    system = system.explicit()
    form = staircase(system.A, system.C)
    k = form.n_observable
    if k == system.n_states:
        return system
    Q = form.Q[:, :k]
    return system.replaced(
        A=Q.T @ form.A @ Q,
        B=Q.T @ (system.B / form.states[:, None]),
        C=(system.C * form.states) @ Q,
        states=None,
    )


def pair(A: ArrayLike, C: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return matrices that go together, as floats."""
    A = arrays.matrix(A, "A", (None, None))
    A = arrays.matrix(A, "A", (A.shape[0], A.shape[0]))
    return A, arrays.matrix(C, "C", (None, A.shape[0]))


def detectability(A: ArrayLike, C: ArrayLike, *, dt: float = 0) -> Detectability:
    """Tell whether every unobservable mode is stable.

    An unobservable mode counts as stable only when it is inside the stability region by more than rounding may have
    moved it, so that a hidden integrator is never taken for a stable mode, and by 1e-10 on top: ``1 - abs(z)`` of a
    sampled system, ``-Re(s)`` relative to the norm of the balanced ``A`` of a continuous one.

    Parameters
    ----------
    A : array_like, shape (n, n)
    C : array_like, shape (p, n)
    dt : float
        0 for continuous time, otherwise the sample step in seconds.

    Returns
    -------
    Detectability

    Examples
    --------
    >>> bool(detectability([[-1.0, 0.0], [0.0, 0.0]], [[1.0, 0.0]]))
    False
    """
    form = staircase(*pair(A, C))
    modes, uncertainty = form.hidden_modes
    unstable = ~dies_out(modes, uncertainty, dt, form.size)
    loose = uncertainty > np.sqrt(_EPS) * form.size
    scatter = scatter_of(int(np.count_nonzero(loose)), len(modes), form.size)
    undecided = loose & is_stable_mode(modes, dt, uncertainty=-np.maximum(uncertainty, scatter))
    return Detectability(
        not unstable.any(),
        modes,
        modes[unstable],
        form.size,
        tuple(one for one in form.decisions if not one.is_clear),
        bool(unstable.any() and undecided[unstable].all()),
    )
