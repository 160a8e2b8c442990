"""Comparing a spectrum with the requested one, multiple poles included."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError
from residua.linear.poles.stability import modes_with_uncertainty
from residua.linear.subspaces.parts import connected_parts
from residua.tolerances import BALANCED_RANK
from residua.words import counted

Poles = NDArray[np.complex128]
_EPS = float(np.finfo(float).eps)
#: Rates below this, of the fastest or per sample, are those of integrators.
_INTEGRATES = 1e-5
#: No pole may miss by more than this, however ill-conditioned it is.
_MOST_BY_ROUNDING = 1e-3
#: Poles that a chain of relative distances below this connects are a cluster.
_NEAR = 1e-3
#: Relative distances beyond this are all the same, so that sums of them are finite.
_FARTHEST = 1e300


def describe_modes(modes: Iterable[complex] | NDArray) -> str:
    """Return modes as short text for messages."""
    out = []
    for mode in np.asarray(modes, dtype=complex).ravel():
        real = f"{mode.real:.5g}"
        out.append(real if mode.imag == 0 else f"{real}{mode.imag:+.5g}j")
    return ", ".join(out) if out else "none"


def mean_rate(poles: NDArray, dt: float = 0.0) -> float:
    """Return the geometric mean of the rates of poles, in 1/s; those that have none, such as integrators, are left out.

    Where none has a rate, 1 per second, or one time constant in ten samples. Never beyond 1 per sample.
    """
    poles = np.asarray(poles, dtype=complex)
    if not dt:
        rates = np.abs(poles)
        rates = rates[rates > _INTEGRATES * rates.max(initial=0.0)]
        return float(np.exp(np.mean(np.log(rates)))) if rates.size else 1.0
    rates = np.abs(np.log(poles[np.abs(poles) > _INTEGRATES]))
    rates = rates[rates > _INTEGRATES]
    return min(float(np.exp(np.mean(np.log(rates)))) if rates.size else 0.1, 1.0) / dt


def balanced_rate(A: NDArray[np.float64], sampled: bool) -> float:
    """Return the mean rate of a balanced matrix in its unit of time, without the integrators, which rounding may move.

    A chain of ``k`` integrators has eigenvalues as large as the ``k``-th root of rounding. Its null space, divided out
    until there is none, is found to rounding itself.
    """
    M = A - np.eye(len(A)) if sampled else A
    while len(M):
        _, s, Vh = np.linalg.svd(M)
        rest = Vh[: np.count_nonzero(s > BALANCED_RANK)]
        if len(rest) == len(M):
            break
        M = rest @ M @ rest.T
    return mean_rate(np.linalg.eigvals(M) + sampled, float(sampled))


def spectral_radius(A: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the spectral radius of a matrix, or of each of a stack; 0 without states."""
    return np.abs(np.linalg.eigvals(A)).max(axis=-1, initial=0.0) if A.shape[-1] else np.zeros(A.shape[:-2])


def match_poles(wanted: Poles, achieved: Poles) -> NDArray[np.intp]:
    """Return for each wanted pole the index of an achieved one, each used at most once, nearest in sum.

    Parameters
    ----------
    wanted : ndarray of complex, shape (k,)
    achieved : ndarray of complex, shape (n,)
        At least as many.

    Returns
    -------
    ndarray of int, shape (k,)

    Raises
    ------
    AccuracyError
        If a pole is not finite: nothing is nearest to it.
    """
    from scipy.optimize import linear_sum_assignment  # slow to import

    for poles in (wanted, achieved):
        if not np.all(np.isfinite(poles)):
            raise AccuracyError(
                f"{np.count_nonzero(~np.isfinite(poles))} of {counted(poles.size, 'pole')} is no finite number: a "
                "gain, or the plant, is too large for floating-point numbers; rescale it"
            )
    distance = np.abs(wanted[:, None] - achieved)
    # Relative, or a fast pole that is off a little would outweigh a slow one that is off altogether.
    scale = np.abs(wanted)[:, None] + 1e-3 * np.abs(wanted).max(initial=0.0) + np.finfo(float).tiny
    with np.errstate(over="ignore"):
        return np.asarray(linear_sum_assignment(np.minimum(distance / scale, _FARTHEST))[1], dtype=np.intp)


def spectrum_error(block: NDArray[np.float64], wanted: Poles, dt: float, tolerance: float) -> tuple[float, Poles, bool]:
    """Return the error of the poles of ``block``, the poles in the wanted order, and whether they are right.

    A simple pole counts with its own error; beyond the tolerance it passes only if rounding of ``block`` moves it that
    far. The members of a cluster of ``m`` count with the error of their mean, which is well conditioned; each may
    scatter by ``(eps * condition)**(1/m)`` of the norm, which is what a defective pole does, and the wanted pole must
    be an eigenvalue of a matrix within rounding of ``block``.

    Parameters
    ----------
    block : ndarray, shape (k, k)
    wanted : ndarray of complex, shape (k,)
    dt : float
        Errors are relative when 0, absolute otherwise.
    tolerance : float

    Returns
    -------
    error : float
    achieved : ndarray of complex
    reached : bool
    """
    k = wanted.size
    if not k:
        return 0.0, wanted, True
    modes, moved = modes_with_uncertainty(block)
    order = match_poles(wanted, modes)
    achieved, moved = modes[order], 100 * moved[order]
    scale = np.ones(k) if dt else np.abs(wanted)
    size = max(float(np.linalg.norm(block, 2)), float(np.abs(wanted).max()), 1.0 if dt else 0.0)
    worst, reached = 0.0, True
    near = np.abs(wanted[:, None] - wanted) <= _NEAR * np.maximum(np.abs(wanted)[:, None], np.abs(wanted))
    for members in connected_parts(near):
        unit = float(scale[members].mean())
        error = abs(complex(np.mean(achieved[members] - wanted[members]))) / unit
        worst = max(worst, error)
        m = members.size
        if m == 1:
            allowed = max(tolerance, min(float(moved[members][0]) / unit, _MOST_BY_ROUNDING))
            reached &= error <= allowed
            continue
        scatter = float(np.abs(achieved[members] - wanted[members]).max())
        centre = complex(np.mean(wanted[members]))
        backward = float(np.linalg.svd(block - centre * np.eye(k), compute_uv=False)[-1])
        spread = float(np.abs(wanted[members] - centre).max())
        reached &= error <= tolerance
        reached &= scatter <= max(tolerance * unit, size * (1e4 * k * _EPS) ** (1 / m))
        reached &= backward <= 1e4 * k * _EPS * size + spread
    return worst, achieved, bool(reached)
