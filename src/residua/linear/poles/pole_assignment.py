"""Gains that put the poles of an observable pair where they are asked for, by the method that does it best."""

from __future__ import annotations

import warnings

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua.errors import AccuracyError, DesignError, ModelError
from residua.linear.poles.spectrum import describe_modes, spectrum_error
from residua.linear.poles.stability import is_stable_mode
from residua.tolerances import BALANCED_RANK, POLE

Matrix = NDArray[np.float64]


def assigned_gain(
    F: Matrix, G: Matrix, poles: NDArray[np.complex128], sampled: bool, rate: float = 1.0, tolerance: float = POLE
) -> tuple[Matrix, NDArray[np.complex128], float]:
    r"""Return a gain that puts the poles of a balanced observable pair where they are asked for.

    Where every state is seen by an output of its own it is :math:`(F - \Lambda) G^+`, with no iteration; otherwise a
    robust method and a Schur method compete, and the smaller gain among those that reach the poles wins.

    Parameters
    ----------
    F : ndarray, shape (k, k)
    G : ndarray, shape (p, k)
    poles : ndarray of complex, shape (k,)
        Stable, closed under conjugation, of any multiplicity.
    sampled : bool
    rate : float
        The unit of rates in 1/s, for messages.
    tolerance : float
        Largest error of a pole, relative (continuous) or absolute (sampled), of a cluster that of its mean.

    Returns
    -------
    tuple
        The gain, the poles in the order asked for, and the largest error.

    Raises
    ------
    AccuracyError
        If no method reaches the poles.
    """
    U, s, Vh = np.linalg.svd(G, full_matrices=False)
    r, dt = int(np.count_nonzero(s > BALANCED_RANK)), float(sampled)
    H = Vh[:r]
    if not len(F):
        return np.zeros((0, len(G))), poles, 0.0
    if r == len(F):
        gains = [(F - real_block_diagonal(poles)) @ H.T]
    else:
        found = robust_assignment(F, H, poles), schur_assignment(F, H, poles)
        gains = [L for L in found if L is not None and np.all(np.isfinite(L))]
    tried = []
    for L in gains:
        error, achieved, reached = spectrum_error(F - L @ H, poles, dt, tolerance)
        reached = reached and bool(is_stable_mode(achieved, dt).all())
        tried.append(((not reached, float(np.linalg.norm(L)) if reached else error), L, achieved, error))
    best = min(tried, key=lambda one: one[0], default=None)
    if best is None or best[0][0]:
        reason = "every method broke down"
        if best is not None:
            reason = (
                f"reached {describe_modes(rate * best[2])}, error {best[3]:.3g} against {tolerance:.3g}, "
                f"norm of the gain {describe_modes([rate * float(np.linalg.norm(best[1]))])}"
            )
        raise AccuracyError(
            f"the poles {describe_modes(rate * poles)} cannot be placed to the tolerance: {reason}; ask for poles "
            "nearer to those of the plant or further apart, for a margin, or add a sensor"
        )
    _, L, achieved, error = best
    return L / s[:r] @ U[:, :r].T, achieved, error


def checked_poles(poles: ArrayLike, sampled: bool, rate: float = 1.0) -> NDArray[np.complex128]:
    """Return poles that are finite, stable and exactly closed under conjugation; errors say them times a rate."""
    requested = np.atleast_1d(np.asarray(poles, dtype=complex)).ravel()
    if not np.all(np.isfinite(requested)):
        raise ModelError(f"pole {describe_modes(requested[~np.isfinite(requested)][:1])} is not finite")
    unstable = requested[~is_stable_mode(requested, float(sampled))]
    if unstable.size:
        where = "abs(z) < 1" if sampled else "Re(s) < 0"
        raise DesignError(f"pole {describe_modes(rate * unstable[:1])} is not stable: every pole needs {where}")
    requested = np.where(np.abs(np.imag(requested)) <= 1e-12 * np.abs(requested), np.real(requested) + 0j, requested)
    waiting = [p for p in requested if p.imag < 0]
    out: list[complex] = []
    for p in (p for p in requested if p.imag >= 0):
        out.append(p)
        if p.imag > 0:
            partner = min(waiting, key=lambda q: abs(q - np.conj(p)), default=None)
            if partner is None or abs(partner - np.conj(p)) > 1e-8 * abs(p):
                raise ModelError(f"pole {describe_modes([rate * p])} is given without its conjugate")
            waiting.remove(partner)
            out.append(np.conj(p))
    if waiting:
        raise ModelError(f"pole {describe_modes([rate * waiting[0]])} is given without its conjugate")
    return np.array(out, dtype=complex)


def real_block_diagonal(poles: NDArray[np.complex128]) -> Matrix:
    """Return a real matrix with these poles: 1 x 1 blocks, and ``[[a, b], [-b, a]]`` for a pair.

    Parameters
    ----------
    poles : ndarray of complex
        Closed under conjugation; the order of first appearance is kept.

    Returns
    -------
    ndarray
    """
    blocks = [[[p.real]] if p.imag == 0 else [[p.real, p.imag], [-p.imag, p.real]] for p in poles if p.imag >= 0]
    return scipy.linalg.block_diag(*blocks) if blocks else np.zeros((0, 0))


def robust_assignment(F: Matrix, H: Matrix, poles: NDArray[np.complex128]) -> Matrix | None:
    """Return ``L`` with ``eig(F - L H) = poles`` and well-conditioned eigenvectors, or None if it fails.

    Kautsky, Nichols and Van Dooren's method as improved by Tits and Yang; it exists only when no pole occurs more
    often than there are rows in ``H``. With more than 79 states it is not tried: it would take minutes. The caller must
    check the outcome.

    Parameters
    ----------
    F : ndarray, shape (k, k)
    H : ndarray, shape (r, k)
        Of full row rank, the pair observable.
    poles : ndarray of complex, shape (k,)

    Returns
    -------
    ndarray, shape (k, r), or None
    """
    from scipy.signal import place_poles

    counts = np.sum(np.isclose(poles[:, None], poles, rtol=1e-8, atol=0), axis=1)
    sweeps = round(60 * min(1.0, (24 / max(len(F), 1)) ** 4))  # each costs the fifth power of the order
    if counts.max(initial=0) > H.shape[0] or not sweeps:
        return None
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            L = place_poles(F.T, H.T, poles, maxiter=sweeps).gain_matrix.T
    except (ValueError, np.linalg.LinAlgError):
        return None
    return np.real(L)


def schur_assignment(F: Matrix, H: Matrix, poles: NDArray[np.complex128]) -> Matrix | None:
    """Return ``L`` with ``eig(F - L H) = poles`` for poles of any multiplicity, or None if it breaks down.

    One block of the real Schur form is moved at a time, to the pole nearest to it, with the smallest
    gain that does it.

    Parameters
    ----------
    F : ndarray, shape (k, k)
    H : ndarray, shape (r, k)
    poles : ndarray of complex, shape (k,)

    Returns
    -------
    ndarray, shape (k, r), or None

    References
    ----------
    A. Varga, A Schur method for pole assignment, IEEE TAC 26 (1981) 517-519.
    """
    k = F.shape[0]
    T, Z = scipy.linalg.schur(F.T, output="real")
    gain = np.zeros((H.shape[0], k))
    reals = [float(p.real) for p in poles if p.imag == 0]
    pairs = [complex(p) for p in poles if p.imag > 0]
    done = 0
    while done < k:
        size = 2 if k - done >= 2 and T[-1, -2] != 0 else 1
        if size == 1 and not reals:  # two real ones are treated as one when only pairs remain
            if k - done >= 3 and T[-2, -3] != 0 and not _exchange(T, Z, k - 3, k - 1):
                return None
            size = 2
        low = k - size
        G = (H @ Z).T
        f = _block_gain(T[low:, low:], G[low:], _nearest(T[low:, low:], reals, pairs))
        if f is None:
            return None
        T[:, low:] += G @ f
        gain += f @ Z[:, low:].T
        # back to real Schur form, and above the blocks still to do
        block, Q = scipy.linalg.schur(T[low:, low:], output="real")
        T[:low, low:], T[low:, low:], Z[:, low:] = T[:low, low:] @ Q, block, Z[:, low:] @ Q
        places = [k - 1, k - 1] if size == 2 and T[-1, -2] == 0 else [low]
        if not all(_exchange(T, Z, place, done) for place in places):
            return None
        done += size
    return -gain.T


def _exchange(T: Matrix, Z: Matrix, source: int, destination: int) -> bool:
    """Move the diagonal block at ``source`` to ``destination`` (both counted from 0), in place."""
    if source == destination:
        return True
    t, z, info = scipy.linalg.lapack.dtrexc(T, Z, source + 1, destination + 1)
    T[:], Z[:] = t, z
    return info == 0


def _nearest(block: Matrix, reals: list[float], pairs: list[complex]) -> tuple[float, float, float]:
    """Take the pole or pair nearest to the block off the lists; return it as (trace, determinant, real pole)."""
    if block.shape[0] == 1:
        pole = min(reals, key=lambda p: abs(p - block[0, 0]))
        reals.remove(pole)
        return pole, pole, pole
    here = complex(np.linalg.eigvals(block)[0])
    here = complex(here.real, abs(here.imag))
    if pairs and (len(reals) < 2 or min(abs(p - here) for p in pairs) <= min(abs(p - here) for p in reals)):
        pair = min(pairs, key=lambda p: abs(p - here))
        pairs.remove(pair)
        return 2 * pair.real, abs(pair) ** 2, pair.real
    first, second = sorted(reals, key=lambda p: abs(p - here))[:2]
    reals.remove(first)
    reals.remove(second)
    return first + second, first * second, first


def _block_gain(block: Matrix, G: Matrix, target: tuple[float, float, float]) -> Matrix | None:
    """Return the smallest known ``f`` with ``eig(block + G f)`` on target, or None when ``G`` cannot reach it."""
    trace, determinant, pole = target
    U, s, Vh = np.linalg.svd(G)
    if s[0] == 0:
        return None
    if block.shape[0] == 1:
        return Vh[:1].T * ((pole - block[0, 0]) / s[0]) * U[0, 0]
    M = U.T @ block @ U
    candidates = []
    if M[1, 0] != 0:
        # One direction of input suffices: the trace fixes one entry, the determinant the other.
        first = trace - M[1, 1]
        second = (first * M[1, 1] - determinant) / M[1, 0]
        candidates.append(Vh[:1].T @ (np.array([[first, second]]) - M[:1]) @ U.T / s[0])
    if s.size > 1 and s[1] > 1e-12 * s[0]:
        centre = trace / 2
        product = centre**2 - determinant  # of the off-diagonal entries, when the diagonal is (centre, centre)
        root, upper = np.sqrt(abs(product)), float(block[0, 1])
        targets = [[[centre, u], [product / u, centre]] for u in {upper, float(np.copysign(root, upper or 1.0))} if u]
        if product >= 0:
            targets += [[[centre + r, upper], [0.0, centre - r]] for r in (root, -root)]
        candidates += [Vh[:2].T @ ((U.T @ (np.array(X) - block)) / s[:, None]) for X in targets]
    return min(candidates, key=lambda f: float(np.linalg.norm(f)), default=None)
