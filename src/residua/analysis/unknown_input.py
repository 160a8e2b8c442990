"""Whether an observer exists that ignores the disturbances, and if not, why not."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from residua.arrays import frozen
from residua.linear.poles.settled_zeros import settled
from residua.linear.poles.spectrum import describe_modes
from residua.linear.poles.stability import dies_out, may_die_out
from residua.linear.poles.zeros import zeros_apart
from residua.linear.subspaces.observability import Detectability, detectability
from residua.linear.subspaces.rank import (
    DEFAULT_RTOL,
    RankDecision,
    decide_rank,
    left_null_basis,
    null_basis,
    range_basis,
    spectral_norm,
    without_noise,
)
from residua.linear.systems.balancing import descriptor_units, evened, without_rounding
from residua.plant import OperatingPoint, Plant
from residua.plant.channels import ROLES
from residua.plant.comparable_units import EvenPlant, even_plant, in_unit_of_rates
from residua.plant.disturbances import factor_disturbance
from residua.shown import Shown
from residua.tolerances import RANK, RESIDUE, TINY, above_rounding
from residua.words import rates_in


@dataclass(frozen=True, eq=False)
class OutputFreeForm:
    r"""The plant rewritten so that no disturbance enters the outputs that are used.

    With :math:`D_d = U_1 S V_1^T`, the part of ``d`` that reaches the outputs is expressed by them,
    :math:`V_1^T d = S^{-1} U_1^T (y - C x)`, and put into the state equation; the outputs :math:`W y`
    with :math:`W D_d = 0` remain.

    Attributes
    ----------
    A, C, E : ndarray
        Of :math:`\dot x = A x + G y + \dots + E d`, :math:`W y = C x`; ``E`` has full column rank.
    G : ndarray, shape (n, outputs)
    W : ndarray, shape (outputs left, outputs)
    rank_E : RankDecision
    """

    A: NDArray
    C: NDArray
    E: NDArray
    G: NDArray
    W: NDArray
    rank_E: RankDecision


def output_free_form(plant: Plant, *, rtol: float = DEFAULT_RTOL) -> OutputFreeForm:
    """Return the plant with the disturbances removed from its outputs; see :class:`OutputFreeForm`."""
    p, n = plant.n_outputs, plant.n_states
    if not np.any(plant.Dd):
        E1, decision = factor_disturbance(plant.Bd, rtol=rtol)
        E = plant.Bd if decision.rank == plant.Bd.shape[1] else E1
        return OutputFreeForm(plant.A, plant.C, E, np.zeros((n, p)), np.eye(p), decision)
    rows, columns = _units(np.vstack([plant.Bd, plant.Dd]), plant.n_states)
    Bd, Dd = plant.Bd * columns, rows[:, None] * plant.Dd * columns
    live = np.any(plant.C, axis=1) | np.any(Dd, axis=1)  # a dead output stays by itself: no combination reads it
    U, s, Vh = np.linalg.svd(Dd[live])
    U, Vh = without_noise(U), without_noise(Vh)  # no residual reads an output through what rounding left there
    r = int(np.count_nonzero(s > rtol * s[0]))
    whole = np.eye(p)
    G = without_rounding(Bd, Vh[:r].T / s[:r], U[:, :r].T, whole[live]) * rows
    W = without_noise(np.linalg.qr((U[:, r:].T * rows[live]).T)[0].T)
    W = np.vstack([W @ whole[live], whole[~live]])
    rest = without_rounding(Bd, Vh[r:].T)
    scale = spectral_norm(Bd)
    E, decision = factor_disturbance(rest, rtol=rtol)
    if scale and decision.singular_values.size and decision.singular_values[0] <= rtol * scale:
        E, decision = rest[:, :0], RankDecision(0, decision.singular_values, rtol * scale)
    A = without_rounding(np.hstack([np.eye(n), -G]), np.vstack([plant.A, plant.C]))
    return OutputFreeForm(A, without_rounding(W, plant.C), E, G, W, decision)


def _units(F: NDArray, n_states: int) -> tuple[NDArray, NDArray]:
    """Return factors for the outputs and for the disturbances that make their entries comparable."""
    columns = 1.0 / np.maximum(np.abs(F).max(axis=0, initial=0.0), TINY)
    heights = np.abs(F[n_states:] * columns).max(axis=1, initial=0.0)
    rows = 1.0 / np.where(heights > 0, heights, 1.0)
    columns = 1.0 / np.maximum(np.abs(rows[:, None] * F[n_states:]).max(axis=0, initial=0.0), TINY)
    silent = ~np.any(F[n_states:], axis=0)
    return rows, np.where(silent, 1.0 / np.maximum(np.abs(F).max(axis=0, initial=0.0), TINY), columns)


@dataclass(frozen=True, eq=False, repr=False)
class UnknownInputExistence(Shown):
    r"""Whether an unknown input observer exists, with the numbers behind each condition.

    Attributes
    ----------
    exists : bool
    reasons : tuple of str
        Why not, in words and numbers; empty when it exists.
    rank_CE, rank_E : RankDecision
        Condition (i): they must be equal.
    fixed_poles : ndarray
        Invariant zeros of ``(A, E, C)``, which are poles of every such observer; condition (ii): stable.
    useful : bool
        Whether measurements are left over to see faults with (more measurements than disturbances).
    decomposition : OrdinaryDecoupling, SingularDecoupling or None
        What the answer was read from, in even units, which the design goes on with; none in another unit of time.

    References
    ----------
    Chen, Patton and Zhang (1996), Lemma 1, Theorem 1 and the zero test in section 2.
    """

    exists: bool
    reasons: tuple[str, ...]
    rank_CE: RankDecision
    rank_E: RankDecision
    fixed_poles: NDArray[np.complex128]
    useful: bool
    decomposition: OrdinaryDecoupling | SingularDecoupling | None = field(default=None, repr=False)

    def __bool__(self) -> bool:
        return self.exists

    def __str__(self) -> str:
        if not self.exists:
            return "no unknown input observer: " + "; ".join(self.reasons)
        if not self.useful:
            return "an unknown input observer exists, but its residual is zero whatever fails"
        return f"an unknown input observer exists (rank(CE) = rank(E) = {self.rank_E.rank})"


def unknown_input_observer_existence(plant: Plant, *, rtol: float = DEFAULT_RTOL) -> UnknownInputExistence:
    r"""Tell whether an observer exists whose error no disturbance reaches.

    Exactly when (i) :math:`\operatorname{rank}(CE) = \operatorname{rank}(E)` and (ii) the pair
    :math:`(C, A_1)`, :math:`A_1 = A - E(CE)^+CA`, is detectable, that is, the invariant zeros of
    :math:`(A, E, C)` are stable.

    Parameters
    ----------
    plant : Plant
        Disturbances in the outputs are eliminated first. For a singular ``E`` the conditions are
        :math:`\operatorname{rank}[E\ E_d; C\ 0] = n + \operatorname{rank} E_d`, where the algebraic equations count
        as measurements, and stable finite invariant zeros of :math:`(E, A, E_d, C)`.
    rtol : float
        Relative tolerance of every rank decision.

    Returns
    -------
    UnknownInputExistence

    References
    ----------
    Chen, Patton and Zhang (1996), Theorem 1.

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.Plant([[-1, 1], [0, -2]], [[0], [1]], [[1, 0]])
    >>> print(rs.analysis.unknown_input_observer_existence(plant.with_disturbances({"gust": [0, 1]})))
    no unknown input observer: rank(CE)=0 < rank(E)=1: no exact unknown input observer; ...
    """
    own, unit = in_unit_of_rates(plant)
    with rates_in(unit):
        found = decomposed_existence(own, rtol=rtol)
    if own is plant:
        return found
    return replace(found, fixed_poles=unit * found.fixed_poles, decomposition=None)


def decomposed_existence(plant: Plant, *, rtol: float = DEFAULT_RTOL) -> UnknownInputExistence:
    """Return the same in the unit of time that the plant is written in, for a design to go on with."""
    if is_singular(plant):
        return _singular_existence(plant, rtol)
    even = even_plant(plant, explicit=True)
    form = output_free_form(even.plant, rtol=rtol)
    q = form.E.shape[1]
    basis, _ = range_basis(form.E / np.maximum(np.linalg.norm(form.E, axis=0), TINY), rtol=0)  # of full rank
    rank_CE = _product_rank(form.C, basis, rtol)
    useful = len(form.W) > q
    if rank_CE.rank < q:
        reason = (
            f"rank(CE)={rank_CE.rank} < rank(E)={q}: no exact unknown input observer; add a sensor that sees "
            f"{_unseen(even.plant, form)}, or decouple fewer disturbances"
        )
        none = np.zeros(0, dtype=complex)
        return UnknownInputExistence(False, (reason,), rank_CE, form.rank_E, none, useful)
    parts = _ordinary_decoupling(even, form, basis)
    seen = detectability(parts.A22, parts.C2, dt=plant.dt, rtol=rtol)
    fixed, unstable, told = _settled_fixed_poles(even.plant, form, seen, rtol)
    reasons = (_unstable_fixed_pole(unstable, told, q),) if unstable.size else ()
    return UnknownInputExistence(not reasons, reasons, rank_CE, form.rank_E, fixed, useful, None if reasons else parts)


def _settled_fixed_poles(
    plant: Plant, form: OutputFreeForm, seen: Detectability, rtol: float
) -> tuple[NDArray[np.complex128], NDArray[np.complex128], bool]:
    """Return the fixed poles, those that are not stable, and whether that is sure: in doubt, zeros of the plant itself.

    What it was cut into has rounding of its own.
    """
    modes = seen.unobservable_modes
    if not seen.in_doubt or rtol > RANK:
        return modes, seen.unstable_modes, not seen.undecided
    uncertainty = np.zeros(len(modes))
    zeros: NDArray[np.complex128] | None = modes
    if plant.E is None:
        rank = form.E.shape[1] + plant.n_outputs - len(form.W)
        zeros = settled((plant.A, plant.Bd, plant.C, plant.Dd), (rank, modes))[1]
    if zeros is None or np.array_equal(zeros, modes):  # rational numbers say no more
        apart = zeros_apart(plant.A, plant.Bd, plant.C, plant.Dd, plant.E, rtol=rtol)
        if apart is None or len(apart[0]) != len(modes):
            return modes, seen.unstable_modes, not seen.undecided
        zeros, uncertainty = apart
    stable = dies_out(zeros, uncertainty, plant.dt, seen.size)
    undecided = not stable.all() and may_die_out(zeros, uncertainty, plant.dt, seen.size)[~stable].all()
    return zeros, zeros[~stable], not undecided


def _cannot_be_told(pair: str, zero: str) -> str:
    return (
        f"whether {pair} is detectable is undecidable: rounding may have moved {zero}, one of several near one place, "
        "across the boundary of stability; add a sensor"
    )


def _unstable_fixed_pole(unstable: NDArray[np.complex128], told: bool, q: int) -> str:
    bad = describe_modes(unstable)
    if not told:
        return _cannot_be_told("(C, A1)", f"the invariant zero {bad} of (A, E, C)")
    if not q:
        return f"(C, A) is not detectable: no measurement sees the mode {bad}; add a sensor"
    return (
        f"(C, A1) is not detectable: the invariant zero {bad} of (A, E, C) is a fixed pole outside "
        "the stability region; add a sensor, or decouple other disturbances"
    )


@dataclass(frozen=True, eq=False)
class OrdinaryDecoupling:
    r"""A plant cut along its disturbances, :math:`x = Q a + N b` with a basis ``Q`` of the range of ``E``.

    With :math:`P = (C Q)^+`, :math:`P C N = 0`, :math:`L Q = 0` and :math:`L N = I`, the decoupled error of an observer
    has, before any gain,

    .. math:: M^{-1} T A M = \begin{bmatrix} 0 & 0 \\ A_{21} & A_{22} \end{bmatrix}, \qquad
              \begin{bmatrix} P \\ W_2 \end{bmatrix} C M = \begin{bmatrix} I & 0 \\ 0 & C_2 \end{bmatrix}

    with exact zeros: what rounding leaves of ``T E = 0`` has no place to go. The unobservable modes of
    :math:`(C_2, A_{22})` are those of :math:`(C, T A)`, and the invariant zeros of :math:`(A, E, C)`.

    Attributes
    ----------
    even : EvenPlant
        The units of all matrices here.
    form : OutputFreeForm
    basis, M : ndarray, shapes (n, q) and (n, n)
        ``Q``, and ``[Q N]``.
    outputs : ndarray, shape (outputs left that read a state, outputs left)
        ``[P; W2]``.
    A21, A22, C2 : ndarray
    T, H : ndarray, shapes (n, n) and (n, outputs)
        ``H C E = E`` with the smallest ``H``, outputs weighted evenly, ``T = I - H C``.
    """

    even: EvenPlant
    form: OutputFreeForm
    basis: NDArray[np.float64]
    M: NDArray[np.float64]
    outputs: NDArray[np.float64]
    A21: NDArray[np.float64]
    A22: NDArray[np.float64]
    C2: NDArray[np.float64]
    T: NDArray[np.float64]
    H: NDArray[np.float64]

    @property
    def error_pair(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """``T A`` and ``C`` in the coordinates ``M`` and ``outputs``, to place poles with."""
        q, k = self.A21.shape[1], len(self.A22)
        A = np.block([[np.zeros((q, q + k))], [self.A21, self.A22]])
        return A, np.block([[np.eye(q), np.zeros((q, k))], [np.zeros((len(self.C2), q)), self.C2]])


def _ordinary_decoupling(even: EvenPlant, form: OutputFreeForm, Q: NDArray) -> OrdinaryDecoupling:
    """Cut a plant along its disturbances; the rank condition must hold."""
    p, q = len(form.C), Q.shape[1]
    weights = even.output_weights(form.A, form.E, form.C)
    live = np.any(form.C, axis=1)  # a dead output gets no gain, not by a combination with others either
    CQ = weights[live, None] * without_rounding(form.C[live], Q)
    U, s, Vh = np.linalg.svd(CQ) if CQ.size else (np.eye(len(CQ)), np.zeros(0), np.eye(q))
    U, Vh = without_noise(_with_sure_rest(U, s)), without_noise(Vh)
    U = np.eye(p)[:, live] @ U
    P, W2 = without_rounding(Vh.T / s, U[:, :q].T) * weights, U[:, q:].T * weights
    # P C Q = I entry by entry: weights far apart leave small entries with the rounding of large ones
    P = without_rounding(np.hstack([2 * np.eye(q), -P]), np.vstack([np.eye(q), without_rounding(form.C, Q)]), P)
    L = left_null_basis(Q)[0].T
    H = without_rounding(Q, P)
    T = decoupling_map(H, form.C)
    N = without_rounding(T, L.T)
    return OrdinaryDecoupling(
        even,
        form,
        Q,
        np.hstack([Q, N]),
        np.vstack([P, W2]),
        without_rounding(L, form.A, Q),
        without_rounding(L, form.A, N),
        without_rounding(W2, form.C, L.T),
        T,
        without_rounding(H, form.W),
    )


def _with_sure_rest(U: NDArray, s: NDArray) -> NDArray[np.float64]:
    """Return left singular vectors, with exact zeros in those that complete them where nothing else is sure.

    Rounding of the largest singular value turns them towards a vector by as much as that one's value is smaller: an
    output that a combination leaves out, but for this, is not read.
    """
    turn = max(len(U), len(s)) * np.finfo(float).eps * np.abs(U[:, : len(s)]) @ (s[:1] / s)
    rest = U[:, len(s) :]
    return np.hstack([U[:, : len(s)], np.where(np.abs(rest) > turn[:, None], rest, 0.0)])


def decoupling_map(H: NDArray, C: NDArray) -> NDArray[np.float64]:
    """Return ``T = I - H C`` of an ordinary plant, exactly zero where only rounding is left."""
    whole = np.eye(len(H))
    return without_rounding(np.hstack([whole, -H]), np.vstack([whole, C]))


def is_singular(plant: Plant) -> bool:
    """Tell whether ``E`` of a plant is singular."""
    if plant.E is None:
        return False
    rows, columns = evened(plant.E)
    return decide_rank(rows[:, None] * plant.E * columns, rtol=1e-12).rank < plant.n_states


@dataclass(frozen=True, eq=False)
class Decoupling:
    """All solutions of ``T E + H C = I``, ``T E_d = 0`` for a singular plant, on outputs without disturbances.

    They are ``T - Z N``, ``H - Z M`` with any ``Z``, so that ``T A`` may be changed by ``Z N A``: for pole placement
    ``N A`` are further measurements. The algebraic equations are among them.

    Attributes
    ----------
    T : ndarray, shape (n, n)
    H : ndarray, shape (n, outputs left)
    N, M : ndarray, shapes (k, n) and (k, outputs left)
        ``N E + M C = 0``, ``N E_d = 0``, dead outputs left out.
    rank, rank_D : RankDecision
        Of ``[E E_d; C 0]`` and of ``E_d``.
    """

    T: NDArray
    H: NDArray
    N: NDArray
    M: NDArray
    rank: RankDecision
    rank_D: RankDecision


def singular_decoupling(plant: Plant, form: OutputFreeForm, *, rtol: float = DEFAULT_RTOL) -> Decoupling:
    r"""Return the smallest :math:`[T\ H]` with :math:`[T\ H] [E\ E_d; C\ 0] = [I\ 0]`, in balanced units.

    It solves the equations only where ``rank`` is ``n`` more than ``rank_D``.
    """
    n, q, p = plant.n_states, form.E.shape[1], len(form.C)
    E = np.eye(n) if plant.E is None else plant.E
    u = descriptor_units(form.A, E, np.hstack([plant.B, form.E]), form.C, np.zeros((p, len(plant.inputs) + q)))
    R, S, Y = u.equations[:, None], u.states, u.outputs[:, None]
    D = R * form.E
    size = np.linalg.norm(D, axis=0)
    D = D / np.where(size > 0, size, 1.0)
    whole = np.block([[R * E * S, D], [Y * form.C * S, np.zeros((p, q))]])
    level = np.linalg.norm(whole[:, :n], axis=0)  # time has units too: E may be small against C
    whole[:, :n] /= np.where(level > 0, level, 1.0)
    inverse = np.linalg.pinv(whole, rcond=rtol)[:n]
    inverse = above_rounding(inverse, np.abs(inverse).max(initial=0.0), RESIDUE)  # rounding is no coupling
    inverse = inverse / np.where(level > 0, level, 1.0)[:, None]
    read = np.append(np.ones(n, dtype=bool), np.any(form.C, axis=1))  # a dead output gets no gain
    inverse = np.where(read, inverse, 0.0)
    T, H = S[:, None] * inverse[:, :n] * u.equations, S[:, None] * inverse[:, n:] * u.outputs
    free = left_null_basis(whole[read], rtol=rtol, scale=1.0)[0].T @ np.eye(n + p)[read]
    N, M = free[:, :n] * u.equations, free[:, n:] * u.outputs
    return Decoupling(T, H, N, M, decide_rank(whole, rtol=rtol, scale=1.0), decide_rank(D, rtol=rtol, scale=1.0))


def error_pair(decoupling: Decoupling, form: OutputFreeForm) -> tuple[NDArray, NDArray]:
    """Return the pair whose poles are placed: ``T A`` and the measurements ``[C; N A]``."""
    return without_rounding(decoupling.T, form.A), np.vstack([form.C, without_rounding(decoupling.N, form.A)])


def algebraic_equations(plant: Plant, *, without: NDArray | None = None) -> NDArray[np.float64]:
    """Return a basis, of unit size, of the combinations ``N`` of a plant's equations without derivatives, ``N E = 0``.

    Only of those that no disturbance enters by the columns of ``without``, if there are any.
    """
    if plant.E is None:
        return np.zeros((0, plant.n_states))
    drive, direct = np.hstack([plant.B, plant.Bd]), np.hstack([plant.D, plant.Dd])
    u = descriptor_units(plant.A, plant.E, drive, plant.C, direct)
    E = u.equations[:, None] * plant.E * u.states
    D = u.equations[:, None] * (plant.Bd[:, :0] if without is None else without)
    size = np.linalg.norm(D, axis=0)
    D = D / np.where(size > 0, size, 1.0)
    N = left_null_basis(np.hstack([E / (np.linalg.norm(E) or 1.0), D]))[0].T
    N = above_rounding(N, 1.0, RESIDUE) * u.equations
    return N / np.maximum(np.abs(N).max(axis=1, keepdims=True, initial=0.0), TINY)


def with_equations_measured(plant: Plant) -> tuple[Plant, NDArray[np.float64]]:
    """Return a singular plant with its algebraic equations as further outputs, which read zero, and these equations.

    ``N (A x + B u + E_d d) = 0`` with ``N E = 0`` tells of the state what a sensor would. A disturbance that enters one
    by rounding only would have units in which that is all of it.
    """
    N = algebraic_equations(plant)
    measured = plant._with(
        C=frozen(np.vstack([plant.C, without_rounding(N, plant.A)])),
        outputs=(*plant.outputs, *(f"equation {i + 1}" for i in range(len(N)))),
        operating_point=OperatingPoint(
            plant.operating_point.inputs, (*plant.operating_point.outputs, *(0.0,) * len(N))
        ),
        **{
            f"D{role}": frozen(np.vstack([getattr(plant, f"D{role}"), without_rounding(N, getattr(plant, f"B{role}"))]))
            for role in ROLES.values()
        },
    )
    return measured, N


def with_needed_equations(
    plant: Plant, *, used: list[int], rtol: float = DEFAULT_RTOL
) -> tuple[Plant, NDArray[np.float64]]:
    """Return a singular plant with its algebraic equations measured, but only if its state is not determined without.

    By those used. The equations are as in :func:`with_equations_measured`, none if not needed.
    """
    seen = plant if len(used) == plant.n_outputs else _with_outputs(plant, used)
    decoupling = singular_decoupling(seen, output_free_form(seen, rtol=rtol), rtol=rtol)
    if decoupling.rank.rank < plant.n_states + decoupling.rank_D.rank:
        return with_equations_measured(plant)
    return plant, np.zeros((0, plant.n_states))


def _with_outputs(plant: Plant, chosen: list[int]) -> Plant:
    """Return a plant with only some of its outputs, for a rank decision."""
    rows = {f"D{role}": frozen(getattr(plant, f"D{role}")[chosen]) for role in ROLES.values()}
    return plant._with(C=frozen(plant.C[chosen]), outputs=tuple(plant.outputs[i] for i in chosen), **rows)


@dataclass(frozen=True, eq=False)
class SingularDecoupling:
    """A singular plant with all solutions of its decoupling.

    Attributes
    ----------
    even : EvenPlant
        The units of all matrices here.
    measured : Plant
        The plant in even units, its algebraic equations among the outputs where they are needed.
    equations : ndarray
        Those algebraic equations.
    form : OutputFreeForm
    decoupling : Decoupling
    """

    even: EvenPlant
    measured: Plant
    equations: NDArray[np.float64]
    form: OutputFreeForm
    decoupling: Decoupling


def _unstable_zero_of_singular(unstable: NDArray[np.complex128], told: bool) -> str:
    bad = describe_modes(unstable)
    if not told:
        return _cannot_be_told("([C; N A], T A)", f"the finite invariant zero {bad} of (E, A, D, C)")
    return (
        f"([C; N A], T A) is not detectable: the finite invariant zero {bad} of (E, A, D, C) is a fixed pole "
        "outside the stability region; add a sensor, or decouple other disturbances"
    )


def _singular_existence(plant: Plant, rtol: float) -> UnknownInputExistence:
    even, n = even_plant(plant), plant.n_states
    measured, equations = even.plant, np.zeros((0, n))
    form = output_free_form(measured, rtol=rtol)
    decoupling = singular_decoupling(measured, form, rtol=rtol)
    if decoupling.rank.rank < n + decoupling.rank_D.rank:  # the outputs do not determine the state by themselves
        measured, equations = with_equations_measured(even.plant)
        form = output_free_form(measured, rtol=rtol)
        decoupling = singular_decoupling(measured, form, rtol=rtol)
    q = decoupling.rank_D.rank
    reasons: list[str] = []
    fixed = np.zeros(0, dtype=complex)
    if decoupling.rank.rank < n + q:
        reasons.append(
            f"rank [E D; C 0] = {decoupling.rank.rank} < n + rank D = {n + q}, algebraic equations counted as "
            "measurements: no exact unknown input observer; add a sensor that sees the states without equations of "
            "their own" + (f", or decouple fewer disturbances than {', '.join(plant.disturbances)}" if q else "")
        )
    else:
        A1, C1 = error_pair(decoupling, form)
        seen = detectability(A1, C1, dt=plant.dt, rtol=rtol)
        fixed, unstable, told = _settled_fixed_poles(even.plant, form, seen, rtol)
        if unstable.size:
            reasons.append(_unstable_zero_of_singular(unstable, told))
    parts = None if reasons else SingularDecoupling(even, measured, equations, form, decoupling)
    useful = plant.n_outputs > measured.n_outputs - len(form.W) + q  # outputs, beyond what all disturbances use up
    return UnknownInputExistence(not reasons, tuple(reasons), decoupling.rank, decoupling.rank_D, fixed, useful, parts)


def _product_rank(C: NDArray, E: NDArray, rtol: float) -> RankDecision:
    """Return the rank of ``C E``, each entry judged against the terms that it is the sum of."""
    terms = np.abs(C) @ np.abs(E)
    if not terms.size:
        return RankDecision(0, np.zeros(0), 0.0)
    rows = terms.max(axis=1, keepdims=True)
    rows = np.where(rows > 0, rows, 1.0)
    columns = (terms / rows).max(axis=0)
    return decide_rank(C @ E / rows / np.where(columns > 0, columns, 1.0), rtol=rtol, scale=1.0)


def _unseen(plant: Plant, form: OutputFreeForm) -> str:
    """Return the names of the disturbances that the outputs see neither directly nor at once by ``C E``."""
    terms = np.abs(form.C) @ np.abs(form.E)
    hidden, _ = null_basis(without_rounding(form.C, form.E), scale=float(np.linalg.norm(terms)))
    entries = np.vstack([plant.Bd, plant.Dd])
    moved = np.vstack([form.E @ hidden, np.zeros((len(plant.Dd), hidden.shape[1]))])
    weight = np.abs(np.linalg.lstsq(entries, moved, rcond=DEFAULT_RTOL)[0]).max(axis=1, initial=0.0)
    names = [name for name, w in zip(plant.disturbances, weight / max(weight.max(), TINY), strict=True) if w > 1e-6]
    return " or ".join(f"'{name}'" for name in names) or "the disturbance"
