"""The observability staircase: what the outputs see of the state, and what they never will."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.errors import AccuracyError
from residua.linear.poles.settled_zeros import counted_hidden, settled_hidden_part
from residua.linear.poles.stability import dies_out, hidden_modes, may_die_out
from residua.linear.subspaces.rank import DEFAULT_RTOL, RankDecision, spectral_norm, without_noise
from residua.linear.subspaces.staircase_steps import staircase_steps
from residua.linear.subspaces.weak_couplings import WeakCouplings
from residua.linear.systems.array_cache import cached_by_contents, copied
from residua.linear.systems.balancing import balance_system
from residua.tolerances import RANK, RESIDUE, ROUNDING, above_rounding

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
    in_doubt : bool
        Whether rounding may have decided a rank, or moved a mode by more than 1e-10 of ``size``.
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
    in_doubt: bool = False


@dataclass(frozen=True, eq=False)
class Detectability:
    """Whether every mode that the outputs do not see dies out by itself; true or false as a condition.

    Attributes
    ----------
    detectable : bool
    unobservable_modes, unstable_modes : ndarray of complex
        All unobservable modes, and those of them that are not stable (the boundary counts as unstable).
    size : float
        Spectral norm of ``A`` in balanced units.
    in_doubt : bool
        Whether rounding may have decided a rank, or moved a mode by more than 1e-10 of ``size``.
    A, C : ndarray
        What was asked about.
    rtol : float
    undecided : bool
        Whether all unstable modes may be stable: rounding may have scattered them from one place across the boundary.
    """

    detectable: bool
    unobservable_modes: NDArray[np.complex128]
    unstable_modes: NDArray[np.complex128]
    size: float
    in_doubt: bool
    A: NDArray[np.float64] = field(repr=False)
    C: NDArray[np.float64] = field(repr=False)
    rtol: float = DEFAULT_RTOL
    undecided: bool = False

    @cached_property
    def form(self) -> ObservabilityForm:
        """The pair in coordinates in which what is seen stands first; see `observability_form`, which may refuse.

        The answer does not need them: modes are those of balanced units.
        """
        return copied(_kept_form(self.A, self.C, rtol=self.rtol))

    def __bool__(self) -> bool:
        return self.detectable


@dataclass(frozen=True, eq=False)
class Staircase:
    """The staircase in balanced units, ``As = T^-1 A T``, ``Cs = Y C T``, which placement works in."""

    A: NDArray[np.float64]
    C: NDArray[np.float64]
    Q: NDArray[np.float64]
    n_observable: int
    n_seen: int
    decisions: tuple[RankDecision, ...]
    states: NDArray[np.float64]
    outputs: NDArray[np.float64]
    dropped: float
    known_modes: NDArray[np.complex128] | None = None
    in_doubt: bool = False

    @cached_property
    def hidden_modes(self) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
        """The modes of the hidden part, and what rounding may have done to each."""
        if self.known_modes is not None:
            return self.known_modes, 4 * _EPS * np.abs(self.known_modes)
        return hidden_modes(self.A, self.Q, self.n_observable, self.rounding)

    @property
    def rounding(self) -> float:
        """What rounding and dropped parts may have done to the blocks: relative to the whole, not the block."""
        return self.dropped + 10 * self.A.shape[0] * _EPS * self.size

    @property
    def rounding_of_basis(self) -> float:
        """What rounding may have left in ``Q``: that of the norm of ``A`` beside the weakest coupling kept."""
        kept = [one.smallest_kept for one in self.decisions[1:] if one.rank]
        return RESIDUE * max(1.0, self.size / min(kept, default=self.size or 1.0))

    @cached_property
    def size(self) -> float:
        """Spectral norm of ``A``."""
        return spectral_norm(self.A)


def staircase(
    A: NDArray[np.float64],
    C: NDArray[np.float64],
    *,
    rtol: float = DEFAULT_RTOL,
    units: str = "balanced",
    compare: bool = True,
) -> Staircase:
    """Reduce a pair to the observability staircase in balanced units.

    Parameters
    ----------
    A : ndarray, shape (n, n)
    C : ndarray, shape (p, n)
    rtol : float
        Relative to the norm of ``A`` (without its multiple of the identity) or of ``C``.
    units : {"balanced", "given"}
        Even out the norms of rows and columns, or take the caller's units, which are comparable already.
    compare : bool
        Whether couplings that may be rounding are compared with those of copies that differ in their last digits.

    Returns
    -------
    Staircase
        ``Q' A Q = [[A11, 0], [A21, A22]]`` up to what was dropped, which is not set to zero here.
    """
    n, p = A.shape[0], C.shape[0]
    T, Y = np.ones(n), np.ones(p)
    if units == "balanced":
        scaled = balance_system(A, np.zeros((n, 0)), C, np.zeros((p, 0)))
        A, C, T, Y = scaled.A, scaled.C, scaled.states, scaled.outputs
    steps = staircase_steps(A, C, rtol, compare=compare)
    decisions = tuple(steps.decided.decisions)
    form = Staircase(A, C, steps.Q, steps.n_observable, steps.n_seen, decisions, T, Y, steps.dropped)
    return _settled(form, steps.decided) if compare and rtol <= RANK and units == "balanced" else form


def _settled(form: Staircase, decided: WeakCouplings) -> Staircase:
    """Return a staircase with what is hidden from rational numbers, where rounding leaves a doubt."""
    k, n, in_doubt = form.n_observable, len(form.A), decided.in_doubt
    if not in_doubt and k < n and decided.turned > ROUNDING:
        in_doubt = counted_hidden(form.A, form.C) != n - k
    if not in_doubt and (k == n or form.hidden_modes[1].max() <= RANK * form.size):
        return form
    found = settled_hidden_part(form.A, form.C, form.hidden_modes[0])
    if found is None:
        return replace(form, in_doubt=True)
    if not in_doubt and found.basis.shape[1] != n - k:  # by couplings that are surely rounding, as the modes may be
        return replace(form, in_doubt=True)
    Q, modes = form.Q, found.modes
    if in_doubt:
        k = n - found.basis.shape[1]
        Q = np.roll(without_noise(np.linalg.qr(found.basis, mode="complete")[0]), k, axis=1) if k < n else np.eye(n)
    dropped = max(spectral_norm(Q[:, :k].T @ form.A @ Q[:, k:]), spectral_norm(form.C @ Q[:, k:]))
    return replace(form, Q=Q, n_observable=k, dropped=dropped, known_modes=modes, in_doubt=modes is None)


def _same_units(form: Staircase) -> bool:
    """Tell whether the form is orthogonal in the caller's units as it is."""
    return bool(np.all(form.states == 1)) or form.n_observable in (0, len(form.Q))


def _hidden_bases(form: Staircase, noise: float) -> Iterator[NDArray[np.float64]]:
    """Return bases of the hidden subspace in balanced units: as it is, without rounding, and of few states each.

    Entries up to ``noise`` are taken for rounding, which would be a direction where other states have larger units. The
    last one is the identity in some of the rows: what mixes columns there mixes states in whatever units.
    """
    Q2 = form.Q[:, form.n_observable :]
    yield Q2
    if _same_units(form):
        return
    yield above_rounding(Q2, 1.0, noise)
    rows = scipy.linalg.qr(Q2.T, mode="r", pivoting=True)[1][: Q2.shape[1]]
    yield above_rounding(np.linalg.solve(Q2[rows].T, Q2.T).T, 1.0, noise)


def _orthogonal(form: Staircase, hidden: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``Q`` in the caller's units: its last columns span the unobservable subspace ``T Q2``."""
    if _same_units(form):
        return form.Q
    k = form.n_observable
    n = form.Q.shape[0]
    N = form.states[:, None] * hidden
    # Sorted rows and pivoted columns keep the small rows of a badly scaled basis accurate.
    order = np.argsort(-np.abs(N).max(axis=1), kind="stable")
    full = scipy.linalg.qr(N[order], pivoting=True)[0]
    Q = np.empty_like(full)
    Q[order] = full
    return np.hstack([Q[:, n - k :], Q[:, : n - k]])


def _in_units_of_caller(
    form: Staircase, A: NDArray[np.float64], C: NDArray[np.float64], rtol: float
) -> tuple[NDArray[np.float64], float]:
    """Return ``Q`` in the caller's units and what it drops: that of the bases that drops least, or only rounding."""
    k = form.n_observable
    best: tuple[NDArray[np.float64], float] | None = None
    # the hidden subspace is known to rounding times the condition of what sees the rest
    for hidden in _hidden_bases(form, min(rtol, form.rounding_of_basis)):
        Q = _orthogonal(form, hidden)
        dropped = _dropped(A, C, Q, k)
        if best is None or dropped < best[1]:
            best = Q, dropped
        if dropped <= ROUNDING:
            break
    assert best is not None
    return best


def _dropped(A: NDArray, C: NDArray, Q: NDArray, k: int) -> float:
    """Return what is not zero of the zeros of an observability form, relative to the pair."""
    At, Ct = Q.T @ A @ Q, C @ Q
    lost = [
        float(np.linalg.norm(M)) / max(float(np.linalg.norm(whole)), np.finfo(float).tiny)
        for M, whole in ((At[:k, k:], A), (Ct[:, k:], C))
        if M.size
    ]
    return max(lost, default=0.0)


def observability_form(A: ArrayLike, C: ArrayLike, *, rtol: float = DEFAULT_RTOL) -> ObservabilityForm:
    r"""Split a pair orthogonally into its observable part and the rest.

    .. math:: Q^T A Q = \begin{bmatrix} A_{11} & 0 \\ A_{21} & A_{22} \end{bmatrix}, \qquad
              C Q = \begin{bmatrix} C_1 & 0 \end{bmatrix}

    with :math:`(A_{11}, C_1)` observable. Ranks are decided in balanced units, so that they do not depend on those
    of the states and outputs; what has to be dropped in the caller's units is checked and reported.

    Parameters
    ----------
    A : array_like, shape (n, n)
    C : array_like, shape (p, n)
    rtol : float
        Couplings below this fraction of the norm of the balanced pair count as zero.

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
    form = staircase(A, C, rtol=rtol)
    k = form.n_observable
    Q, residual = _in_units_of_caller(form, A, C, rtol)
    At, Ct = Q.T @ A @ Q, C @ Q
    if residual > max(_MOST_DROPPED, 10 * rtol):
        raise AccuracyError(
            f"the observability form drops {residual:.3g} of the norm of (A, C) with rtol={rtol:.3g}; "
            "scale the states to comparable units"
        )
    At[:k, k:] = 0.0
    Ct[:, k:] = 0.0
    modes, uncertainty = form.hidden_modes
    return ObservabilityForm(Q, At, Ct, k, form.decisions, modes, uncertainty, residual, form.size, form.in_doubt)


_kept_form = cached_by_contents(observability_form)


def pair(A: ArrayLike, C: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return matrices that go together, as floats."""
    A = arrays.matrix(A, "A", (None, None))
    A = arrays.matrix(A, "A", (A.shape[0], A.shape[0]))
    return A, arrays.matrix(C, "C", (None, A.shape[0]))


@cached_by_contents
def _kept_modes(
    A: NDArray[np.float64], C: NDArray[np.float64], *, rtol: float
) -> tuple[NDArray[np.complex128], NDArray[np.float64], float, bool]:
    """Return the modes that no output sees, what rounding may have done to each, the size of ``A``, and a doubt."""
    form = staircase(A, C, rtol=rtol)
    return *form.hidden_modes, form.size, form.in_doubt


def detectability(A: ArrayLike, C: ArrayLike, *, dt: float = 0, rtol: float = DEFAULT_RTOL) -> Detectability:
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
    rtol : float
        See `observability_form`.

    Returns
    -------
    Detectability

    Examples
    --------
    >>> bool(detectability([[-1.0, 0.0], [0.0, 0.0]], [[1.0, 0.0]]))
    False
    """
    A, C = pair(A, C)
    modes, uncertainty, size, in_doubt = copied(_kept_modes(A, C, rtol=rtol))
    stable = dies_out(modes, uncertainty, dt, size)
    undecided = not stable.all() and bool(may_die_out(modes, uncertainty, dt, size)[~stable].all())
    own = A.copy(), C.copy()  # theirs may change
    return Detectability(bool(stable.all()), modes, modes[~stable], size, in_doubt, *own, rtol, undecided)
