"""The peak norm: the largest output that inputs of bounded size can cause."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError, SettingError
from residua.linear.norms.impulse_terms import StableSystem, impulse_blocks, stable_system
from residua.linear.norms.peak_direction import largest_sum
from residua.linear.norms.peak_norm_lmi import lmi_peak
from residua.linear.norms.star_norm import star_ellipsoid
from residua.linear.systems.state_space import StateSpace

Matrix = NDArray[np.float64]
KINDS = ("exact", "star", "lmi")
#: Numbers of the impulse response that are kept where several outputs are weighed against each other.
_STORED = 20_000_000
#: What rounding of a sum may do to it.
_ROUNDED = 1 + 1e-12


@dataclass(frozen=True, eq=False)
class PeakNorm:
    """The largest output for inputs of unit size.

    Attributes
    ----------
    value : float
        No input of unit size causes a larger output, at any time, from rest.
    attained : float
        An output of this size is caused by :func:`peak_input` along ``direction``; NaN for ``"star"`` and ``"lmi"``.
    kind : {"exact", "star", "lmi"}
    componentwise : bool
        Whether sizes are largest entries instead of Euclidean lengths.
    direction : ndarray, shape (p,), or None
        Of the largest output; ``"exact"`` only.
    terms : int
        Terms of the impulse response that were summed up; what is cut off is in ``value``.
    tail : float
        Bound on what was cut off.
    rate : float
        ``1 - 1 / a`` of the ellipsoid; NaN for ``"exact"``.
    ellipsoid : ndarray, shape (n, n), or None
        ``Q``: all states that inputs of unit size reach from rest lie in ``x' Q^-1 x <= 1``.
    """

    value: float
    attained: float
    kind: str
    componentwise: bool = False
    direction: NDArray[np.float64] | None = None
    terms: int = 0
    tail: float = 0.0
    rate: float = float("nan")
    ellipsoid: Matrix | None = None

    @property
    def a(self) -> float:
        """The parameter ``a = 1 / (1 - rate)`` of the star norm."""
        return 1 / (1 - self.rate)

    def __float__(self) -> float:
        return self.value


def peak_norm(
    system: StateSpace,
    *,
    kind: str = "exact",
    componentwise: bool = False,
    rtol: float = 1e-6,
    most_terms: int = 5_000_000,
) -> PeakNorm:
    r"""Find the largest output of a sampled system for inputs with ``|v(k)| <= 1`` at every sample.

    With the impulse response :math:`h_0 = D,\; h_k = C A^{k-1} B`, and Euclidean lengths at each sample,

    .. math:: \sup_{|v(k)|_2 \le 1} |y(k)|_2 = \max_{|g|_2 = 1} \sum_k |h_k^T g|_2

    ``"exact"``: this number. One output: the sum. Several: ascent from many directions, and a proof that no other is
    better, either by a relaxation that is mostly exact or by a search over cones. The impulse response is cut off where
    a geometric series, in a norm in which ``A`` contracts, bounds the rest; that bound is added to ``value``.

    ``"star"``: the smallest bound by an ellipsoid, one Lyapunov equation for each :math:`a`:
    :math:`Q = a A Q A^T + \tfrac{a}{a-1} B B^T`, :math:`J = \sigma_{max}(C Q C^T)^{1/2} + \sigma_{max}(D)`. It has one
    minimum in :math:`a` only. Milliseconds, at most systems within some per cent of ``"exact"``.

    ``"lmi"``: minimise :math:`\sqrt{g_1 + g_2}` over :math:`P` and :math:`\lambda = 1 - 1/a` subject to
    :math:`[A\,B]^T P [A\,B] \le \mathrm{diag}((1-\lambda) P, \lambda g_1 I)` and
    :math:`[C\,D]^T [C\,D] \le \mathrm{diag}(P, g_2 I)`; needs the extra ``lmi``. Never above ``"star"``: better where
    ``D`` is not zero.

    Parameters
    ----------
    system : StateSpace
        Sampled and stable.
    kind : {"exact", "star", "lmi"}
    componentwise : bool
        Largest entries instead of lengths, for inputs and outputs: the largest row sum of ``sum_k |h_k|``; ``"exact"``
        only.
    rtol : float
        Of ``"exact"``: how far ``value`` may lie above what is attained, relatively.
    most_terms : int
        Of ``"exact"``: where to give up, for slow systems.

    Returns
    -------
    PeakNorm

    Raises
    ------
    ModelError
        If the system is continuous (sample it first, ``system.discretize(dt)``; the norm then is that at the sample
        instants for held inputs: between the samples a continuous output may exceed it), or not stable.
    AccuracyError
        If the tolerance is not met: too slow a system, or many outputs.
    MissingExtraError
        If ``"lmi"`` is asked for and the extra ``lmi`` is absent.

    Notes
    -----
    Assumes
        Rest at the start. A start inside the ellipsoid of ``"star"`` is covered by ``"star"`` too.

    Scaling inputs or outputs each by its own factor changes the norm: ``|v| <= 1`` is in their units. Units of states
    do not matter; they are balanced first.

    References
    ----------
    Abedor, Nagpal and Poolla (1996), A linear matrix inequality approach to peak-to-peak gain minimization, Int. J.
    Robust and Nonlinear Control 6, 899-927; robust l1 fault detection, eqs. (46)-(48).

    Examples
    --------
    >>> from residua.linear import StateSpace, peak_norm
    >>> lag = StateSpace([[0.8]], [[1.0]], [[1.0]], dt=1.0)
    >>> round(peak_norm(lag).value, 4), round(peak_norm(lag, kind="star").value, 4)
    (5.0, 5.0)
    """
    if kind not in KINDS:
        raise SettingError(f"kind must be one of {', '.join(map(repr, KINDS))}, got {kind!r}")
    if not 1e-10 <= rtol < 1:
        raise SettingError(f"rtol must lie in [1e-10, 1), got {rtol!r}")
    if componentwise and kind != "exact":
        raise SettingError(f"componentwise sizes have an exact norm only: kind='exact', not {kind!r}")
    s = stable_system(system)
    if kind == "exact":
        if componentwise or s.D.shape[0] <= 1 or not s.D.size:
            return _by_sums(s, rtol, most_terms, componentwise)
        return _by_directions(s, rtol, most_terms)
    star = star_ellipsoid(s)
    Q = s.units[:, None] * star.Q * s.units
    result = PeakNorm(star.bound, np.nan, kind, rate=star.rate, ellipsoid=Q)
    better = lmi_peak(s, star) if kind == "lmi" else None
    if better is None:
        return result
    value, rate, ellipsoid = better
    return replace(result, value=value, rate=rate, ellipsoid=ellipsoid)


def _by_sums(s: StableSystem, rtol: float, most: int, componentwise: bool) -> PeakNorm:
    """Sum up lengths (or absolute values) of the rows of the impulse response."""
    p, m = s.D.shape
    total, count, bound = np.zeros(p), 0, 0.0
    factor = np.sqrt(m) if componentwise else 1.0  # a row's absolute values sum up to this many times its length
    for H, rest in impulse_blocks(s, most=most):
        total += (np.abs(H).sum(axis=2) if componentwise else np.linalg.norm(H, axis=2)).sum(axis=0)
        count, bound = count + len(H), factor * rest
        if bound <= rtol * total.max(initial=0.0) or not bound:
            break
    else:
        raise _too_slow(s, total.max(initial=0.0), bound, count)
    best = float(total.max(initial=0.0))
    where = np.zeros(p)
    where[int(np.argmax(total)) if p else slice(0)] = 1.0
    return PeakNorm((best + bound) * _ROUNDED, best, "exact", componentwise, where, count, bound)


def _by_directions(s: StableSystem, rtol: float, most: int) -> PeakNorm:
    most = min(most, _STORED // s.D.size)
    blocks, rows, bound = [], np.zeros(len(s.D)), np.inf
    for H, rest in impulse_blocks(s, most=most):
        blocks.append(H)
        rows += np.linalg.norm(H, axis=2).sum(axis=0)
        bound = rest
        if bound <= 0.2 * rtol * rows.max() or not bound:
            break
    else:
        raise _too_slow(s, float(rows.max()), bound, sum(map(len, blocks)))
    H = np.concatenate(blocks)
    largest = largest_sum(H, rtol=0.5 * rtol)
    value = (largest.upper + bound) * _ROUNDED
    if value > largest.attained * (1 + rtol):
        raise AccuracyError(
            f"the peak norm of {s.D.shape[0]} outputs lies between {largest.attained:.9g} and {value:.9g}, and was not "
            f"found to rtol={rtol:.0e}: use a larger rtol, kind='star', or fewer outputs"
        )
    return PeakNorm(value, largest.attained, "exact", False, largest.direction, len(H), bound)


def _too_slow(s: StableSystem, low: float, bound: float, count: int) -> AccuracyError:
    return AccuracyError(
        f"after {count} terms of the impulse response the peak norm is only known to lie between {low:.6g} and "
        f"{low + bound:.6g} (spectral radius {s.radius:.12g}): allow more terms with most_terms, use a larger rtol, or "
        "kind='star'"
    )


def peak_input(system: StateSpace, peak: PeakNorm, samples: int) -> Matrix:
    r"""Return the input of unit size that drives the output to its peak at the last sample.

    The impulse response backwards in time: :math:`v(N-k) = h_k^T g / |h_k^T g|_2`; signs of its entries when
    componentwise.

    Parameters
    ----------
    system : StateSpace
    peak : PeakNorm
        Of kind ``"exact"``.
    samples : int
        Length; the more, the nearer the last output comes to ``peak.attained``.

    Returns
    -------
    ndarray, shape (samples, m)

    Examples
    --------
    >>> from residua.linear import StateSpace, peak_input, peak_norm
    >>> lag = StateSpace([[-0.6]], [[1.0]], [[2.0]], [[0.5]], dt=1.0)
    >>> peak = peak_norm(lag)
    >>> v = peak_input(lag, peak, 60)
    >>> round(peak.value, 6), lag.simulate(v)[-1].round(6)
    (5.5, array([5.5]))
    """
    if peak.direction is None:
        raise SettingError(f"only kind='exact' finds the direction of the peak, and this is kind={peak.kind!r}")
    s = stable_system(system)
    g = peak.direction
    v = np.zeros((samples, s.D.shape[1]))
    row, parts = s.C.T @ g, [s.D.T @ g]
    for _ in range(samples - 1):
        parts.append(s.B.T @ row)
        row = s.A.T @ row
    for k, part in enumerate(parts[:samples]):
        size = np.linalg.norm(part)
        v[samples - 1 - k] = np.sign(part) if peak.componentwise else part / size if size else 0.0
    return v
