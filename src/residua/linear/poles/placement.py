"""Observer gains: poles where they were asked for, or all beyond a margin, with the outcome checked."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.errors import AccuracyError, DesignError, ModelError
from residua.linear.poles.doubling import filter_covariance
from residua.linear.poles.matrix_poles import explicit_poles
from residua.linear.poles.pole_assignment import polished, real_block_diagonal, robust_assignment, schur_assignment
from residua.linear.poles.spectrum import describe_modes, match_poles, spectrum_error
from residua.linear.poles.stability import is_stable_mode
from residua.linear.subspaces.far_gain import refuse_far_gain
from residua.linear.subspaces.observable_part import ObservablePart, observable_part
from residua.linear.subspaces.rank import spectral_norm
from residua.tolerances import POLE
from residua.words import counted, unit_of_rates

Matrix = NDArray[np.float64]
_EPS = float(np.finfo(float).eps)
Poles = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Placement:
    """An observer gain and what it achieved.

    Attributes
    ----------
    gain : ndarray, shape (n, p)
        ``K``; the poles are those of ``A - K C``. It ignores the left null directions of ``C``: ``K = K C C^+``.
    requested : ndarray of complex
        Requested poles of the observable part, in that order; empty when a margin was asked for.
    achieved : ndarray of complex
        Poles reached on the observable part, in the order of ``requested``.
    fixed : ndarray of complex
        Unobservable modes, which no gain moves.
    error : float
        Largest distance between a pole and its request: relative in continuous time, absolute in sampled time;
        for a multiple pole, the distance of the mean of its cluster. Zero for a margin.
    block : ndarray, shape (k, k)
        The observable block of ``A - K C`` in balanced units.
    norm : float
        Spectral norm of ``gain``.
    """

    gain: Matrix
    requested: Poles
    achieved: Poles
    fixed: Poles
    error: float
    block: Matrix
    norm: float

    @cached_property
    def condition(self) -> float:
        """Condition number of the eigenvectors of the observable part, in balanced units. Large for multiple poles."""
        return float(np.linalg.cond(np.linalg.eig(self.block)[1])) if self.block.size else 1.0


def _checked_poles(poles: ArrayLike, dt: float) -> Poles:
    """Return poles that are finite, stable and exactly closed under conjugation."""
    requested: Poles = np.atleast_1d(np.asarray(poles, dtype=complex)).ravel()
    if not np.all(np.isfinite(requested)):
        raise ModelError(f"pole {describe_modes(requested[~np.isfinite(requested)][:1])} is not finite")
    unstable = requested[~is_stable_mode(requested, dt)]
    if unstable.size:
        where = "abs(z) < 1" if dt else "Re(s) < 0"
        raise DesignError(f"pole {describe_modes(unstable[:1])} is not stable: every pole needs {where}")
    requested = np.where(np.abs(np.imag(requested)) <= 1e-12 * np.abs(requested), np.real(requested) + 0j, requested)
    waiting = [p for p in requested if p.imag < 0]
    out: list[complex] = []
    for p in (p for p in requested if p.imag >= 0):
        out.append(p)
        if p.imag > 0:
            partner = min(waiting, key=lambda q: abs(q - np.conj(p)), default=None)
            if partner is None or abs(partner - np.conj(p)) > 1e-8 * abs(p):
                raise ModelError(f"pole {describe_modes([p])} is given without its conjugate")
            waiting.remove(partner)
            out.append(np.conj(p))
    if waiting:
        raise ModelError(f"pole {describe_modes(waiting[:1])} is given without its conjugate")
    return np.array(out, dtype=complex)


def _movable(poles: Poles, problem: ObservablePart, tolerance: float) -> Poles:
    """Take the fixed poles off a list of ``n`` poles; pass a list of ``n_observable`` through."""
    k, fixed = problem.order, problem.fixed
    n = k + fixed.size
    if poles.size == k:
        return poles
    hint = f"; give the {counted(k, 'pole')} of the observable part" if fixed.size else ""
    if poles.size != n:
        are = "is" if k == 1 else "are"
        raise DesignError(
            f"got {counted(poles.size, 'pole')} for {counted(n, 'state')}, of which {k} {are} observable{hint}"
        )
    order = match_poles(fixed, poles)
    scale = np.ones(fixed.size) if problem.dt else np.maximum(np.abs(fixed), np.finfo(float).tiny)
    missed = np.abs(poles[order] - fixed) > max(tolerance, POLE) * scale
    rest = np.delete(poles, order)
    if missed.any() or not np.allclose(np.sort_complex(rest), np.sort_complex(rest.conj())):
        raise DesignError(
            f"the modes {describe_modes(fixed)} are not observable and stay where they are, but "
            f"{describe_modes(fixed[missed] if missed.any() else fixed)} are not among the requested poles{hint}"
        )
    return rest


def _candidates(problem: ObservablePart, poles: Poles) -> list[Matrix]:
    """Return gains ``L`` of the observable part from every method that applies."""
    F, H = problem.F, problem.H
    if H.shape[0] == problem.order:
        # Every state is seen: F - L H = Lambda is solved exactly.
        return [(F - real_block_diagonal(poles)) @ H.T]
    gains = [robust_assignment(F, H, poles), schur_assignment(F, H, poles)]
    return [polished(F, H, L, poles) for L in gains if L is not None and np.all(np.isfinite(L))]


def _direct_gain(problem: ObservablePart, poles: Poles) -> Matrix:
    """Return ``(A - Lambda) C^+`` in the caller's coordinates, for ``C`` of full column rank."""
    T = problem.form.states
    # The pair blocks of Lambda belong in balanced units; its real entries are the same in all.
    target = T[:, None] * real_block_diagonal(poles) / T
    return problem.without_left_null((problem.A - target) @ problem.pseudo_inverse)


def _closed_loop(problem: ObservablePart, K: Matrix) -> tuple[Matrix, float]:
    """Return the observable block of ``A - K C`` in balanced units, and the size of what couples into it."""
    form, k = problem.form, problem.order
    Ks = K / form.states[:, None] / form.outputs
    M = form.Q.T @ (form.A - Ks @ form.C) @ form.Q
    return M[:k, :k], float(np.linalg.norm(M[:k, k:]))


def _placement(
    problem: ObservablePart, K: Matrix, requested: Poles, error: float, achieved: Poles, block: Matrix
) -> Placement:
    return Placement(K, requested, achieved, problem.fixed.copy(), error, block, spectral_norm(K))


def place_observer_poles(
    A: ArrayLike,
    C: ArrayLike,
    poles: ArrayLike,
    *,
    dt: float = 0,
    tolerance: float = POLE,
) -> Placement:
    r"""Find a gain that puts the observable poles of ``A - K C`` where they are asked for.

    The unobservable modes are split off first. Where every observable state is seen by an independent output the
    gain is :math:`K = (A - \Lambda) C^+`, with no iteration; otherwise a robust method and a Schur method compete,
    and the more exact one wins, the smaller gain among equals. The spectrum of the outcome is checked. Poles may
    occur any number of times.

    Assumes
        Unobservable modes are stable.

    Parameters
    ----------
    A : array_like, shape (n, n)
    C : array_like, shape (p, n)
    poles : array_like of complex
        One for each observable state, or ``n`` that include the unobservable modes; closed under conjugation, stable.
    dt : float
        0 for continuous time, otherwise the sample step in seconds.
    tolerance : float
        Largest error of a pole, relative (continuous) or absolute (sampled). A pole may miss it by what rounding of
        ``A - K C`` does to it, up to a thousandth; the members of an m-fold pole may scatter by about
        ``eps**(1/m)``, but their mean may not.

    Returns
    -------
    Placement

    Raises
    ------
    ModelError
        If a matrix is malformed, or the poles are not finite or not closed under conjugation.
    DesignError
        If a pole is unstable, an unobservable mode is, or the number of poles does not fit.
    AccuracyError
        If no method reaches the poles.

    References
    ----------
    Kautsky, Nichols and Van Dooren, Int. J. Control 41 (1985) 1129-1155; Varga, IEEE TAC 26 (1981) 517-519.

    Examples
    --------
    >>> placed = place_observer_poles([[0, 1], [0, 0]], [[1, 0]], [-2, -3])
    >>> placed.gain.round(9)
    array([[5.],
           [6.]])
    """
    problem = observable_part(A, C, dt)
    wanted = _movable(_checked_poles(poles, problem.dt), problem, tolerance)
    n = problem.A.shape[0]
    if problem.order == 0:
        K = np.zeros((n, problem.C.shape[0]))
        return Placement(K, wanted, wanted, problem.fixed.copy(), 0.0, np.zeros((0, 0)), 0.0)
    if problem.H.shape[0] == problem.order == n:
        gains = [_direct_gain(problem, wanted)]
    else:
        gains = [problem.full_gain(L) for L in _candidates(problem, wanted)]
    best: tuple[tuple[bool, float, float], Placement] | None = None
    for K in gains:
        block, leak = _closed_loop(problem, K)
        error, achieved, reached = spectrum_error(block, wanted, problem.dt, tolerance)
        reached = reached and _is_closed_loop_stable(problem, block, np.linalg.eigvals(block), leak)
        placed = _placement(problem, K, wanted, error, achieved, block)
        rank = (not reached, 0.0 if reached else error, placed.norm)
        if best is None or rank < best[0]:
            best = (rank, placed)
    if best is None or best[0][0]:
        reason = (
            "every method broke down"
            if best is None
            else (
                f"reached {describe_modes(best[1].achieved)}, error {best[1].error:.3g} against {tolerance:.3g}, "
                f"norm of the gain {best[1].norm * unit_of_rates():.3g}"
            )
        )
        raise AccuracyError(
            f"the poles {describe_modes(wanted)} cannot be placed to the tolerance: {reason}; ask for poles nearer to "
            "those of the plant or further apart, for a margin (place_observer_margin), or add a sensor"
        )
    return best[1]


def _is_closed_loop_stable(
    problem: ObservablePart, block: Matrix, poles: NDArray, leak: float, margin: float = 0.0
) -> bool:
    """Check that the poles are stable, whatever dropped couplings of size ``leak`` do to them.

    What couples from the unobservable part into the observable one would be zero but for rounding and for what
    the staircase dropped; a large gain magnifies it.
    """
    size = float(np.linalg.norm(block)) + float(np.linalg.norm(problem.form.A))
    return bool(is_stable_mode(poles, problem.dt, margin).all() and leak <= 1e-6 * size)


def default_margin(A: ArrayLike, dt: float = 0) -> float:
    """Return a decay rate that suits the plant: the geometric mean of its nonzero ``abs(s)``.

    Sampled poles are mapped by ``s = log(z) / dt`` first; those at 0 have no rate and are left out. A plant of
    integrators only gets 1 per second, or one time constant in ten samples.

    Parameters
    ----------
    A : array_like, shape (n, n)
    dt : float
        0 for continuous time, otherwise the sample step in seconds.

    Returns
    -------
    float
        In 1/s; never beyond 1 per sample.

    Examples
    --------
    >>> round(default_margin([[-1.0, 0.0], [0.0, -4.0]]), 9)
    2.0
    """
    dt = arrays.sample_step(dt)
    A = arrays.matrix(A, "A", (None, None))
    A = arrays.matrix(A, "A", (A.shape[0], A.shape[0]))
    if dt:
        modes = 1.0 + explicit_poles(A - np.eye(len(A)))  # one is the pole that has no rate
        modes = modes[np.abs(modes) > 1e-6]
        rates = np.abs(np.log(modes)) / dt
        rates = rates[rates * dt > 1e-6]
    else:
        rates = np.abs(explicit_poles(A))
        rates = rates[rates > 1e-8 * rates.max(initial=0.0)]
    if not rates.size:
        return 0.1 / dt if dt else 1.0
    mean = float(np.exp(np.mean(np.log(rates))))
    return min(mean, 1.0 / dt) if dt else mean


def place_observer_margin(
    A: ArrayLike,
    C: ArrayLike,
    margin: float | None = None,
    *,
    dt: float = 0,
) -> Placement:
    r"""Find a gain of moderate size that brings every observable pole beyond a decay rate.

    A filter Riccati equation is solved for the plant shifted by the margin :math:`\alpha`: for :math:`A + \alpha I`
    in continuous time, for :math:`e^{\alpha\,dt} A` in sampled time. Then :math:`\mathrm{Re}\,s < -\alpha`,
    respectively :math:`|z| < e^{-\alpha\,dt}`, for every observable pole; this is checked.
    Unobservable modes stay where they are.

    Assumes
        Unobservable modes are stable.

    Parameters
    ----------
    A : array_like, shape (n, n)
    C : array_like, shape (p, n)
    margin : float, optional
        In 1/s, not negative. `default_margin` when omitted.
    dt : float
        0 for continuous time, otherwise the sample step in seconds.

    Returns
    -------
    Placement

    Raises
    ------
    DesignError
        If an unobservable mode is not stable.
    AccuracyError
        If the poles do not end up beyond the margin.

    References
    ----------
    Anderson and Moore, Linear system optimization with prescribed degree of stability, Proc. IEE 116 (1969) 2083-2087.

    Examples
    --------
    >>> placed = place_observer_margin([[0, 1], [0, 0]], [[1, 0]], 2.0)
    >>> bool(placed.achieved.real.max() < -2)
    True
    """
    problem = observable_part(A, C, dt)
    margin = default_margin(A, dt) if margin is None else float(margin)
    if not np.isfinite(margin) or margin < 0:
        raise DesignError(f"the margin must be a finite rate of at least 0 per second, got {margin * unit_of_rates()}")
    none = np.zeros(0, dtype=complex)
    if problem.order == 0:
        K = np.zeros((problem.A.shape[0], problem.C.shape[0]))
        return Placement(K, none, none, problem.fixed.copy(), 0.0, np.zeros((0, 0)), 0.0)
    tried: list[Matrix] = []
    for weight in (1.0, 100.0, 1e-2, 1e4):
        L = _shifted_riccati(problem, margin, weight)
        if L is None:
            continue
        tried.append(L)
        K = problem.full_gain(L)
        block, leak = _closed_loop(problem, K)
        poles = np.linalg.eigvals(block)
        if _is_closed_loop_stable(problem, block, poles, leak, margin):
            return _placement(problem, K, none, 0.0, poles.astype(complex), block)
    for L in sorted(tried, key=np.linalg.norm)[:1]:
        # Rounding of a huge gain moves the poles, and whether they pass is luck: the reason must not hang on it.
        refuse_far_gain(problem.F, problem.H, L, 1.0 if problem.dt else margin)
    raise AccuracyError(
        f"no gain found with every observable pole beyond the margin {margin * unit_of_rates():.3g} per second "
        f"({problem.order} observable states, {problem.H.shape[0]} independent outputs); "
        "ask for a smaller margin or add a sensor"
    )


def _shifted_riccati(problem: ObservablePart, margin: float, weight: float) -> Matrix | None:
    """Return the gain of the filter for the shifted plant, or None if the equation is not solved."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the caller checks the outcome
            L = _shifted_gain(problem, margin, weight)
    except (np.linalg.LinAlgError, ValueError):
        return None
    return L if np.all(np.isfinite(L)) else None


def _shifted_gain(problem: ObservablePart, margin: float, weight: float) -> Matrix:
    F, H, dt = problem.F, problem.H, problem.dt
    eye_states, eye_outputs = np.eye(F.shape[0]), np.eye(H.shape[0])
    if dt:
        shifted = F * np.exp(margin * dt)
        P = filter_covariance(shifted, H, weight * eye_states, eye_outputs, dt=dt)
        return np.asarray(np.linalg.solve(H @ P @ H.T + eye_outputs, H @ P @ F.T).T, dtype=np.float64)
    # where nothing is split off, the poles of F are those of A, which are known
    rate = max(margin, default_margin(F if problem.fixed.size else problem.A))
    noise = weight * rate**2 * eye_states
    P = filter_covariance(F + margin * eye_states, H, noise, eye_outputs, dt=dt)
    return np.asarray(P @ H.T, dtype=np.float64)
