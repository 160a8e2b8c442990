"""Observer gains: poles where they were asked for, or all beyond a margin, with the outcome checked."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.errors import AccuracyError, DesignError
from residua.linear.poles.observer_gain import observer_gain
from residua.linear.poles.spectrum import describe_modes, mean_rate
from residua.linear.poles.stability import dies_out
from residua.linear.subspaces.observability import pair, staircase
from residua.linear.subspaces.quotient import ObservableSplit
from residua.linear.subspaces.rank import spectral_norm
from residua.tolerances import POLE

Matrix = NDArray[np.float64]
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
    return _placement(A, C, dt, poles=np.asarray(poles), tolerance=tolerance)


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
    return mean_rate(np.linalg.eigvals(arrays.matrix(A, "A", (A.shape[0], A.shape[0]))), dt)


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
    margin = default_margin(A, dt) if margin is None else float(margin)
    if not np.isfinite(margin) or margin < 0:
        raise DesignError(f"the margin must be a finite rate of at least 0 per second, got {margin}")
    return _placement(A, C, dt, margin=margin)


def _placement(
    A: ArrayLike,
    C: ArrayLike,
    dt: float,
    *,
    poles: NDArray | None = None,
    margin: float | None = None,
    tolerance: float = POLE,
) -> Placement:
    """Return the gain of the observable part of a pair, in the caller's units."""
    dt = arrays.sample_step(dt)
    A, C = pair(A, C)
    form = staircase(A, C)
    k, rate = form.n_observable, 1.0 if dt else form.rate
    fixed, uncertainty = form.hidden_modes
    bad = fixed[~dies_out(fixed, uncertainty, dt, form.size)]
    if bad.size:
        raise DesignError(
            f"not detectable: mode {describe_modes(bad)} is not seen by any output and is not stable "
            f"({k} of {len(A)} states observable); add a sensor that sees it"
        )
    seen, hidden = np.eye(len(A)) if k == len(A) else form.Q[:, :k], form.Q[:, k:]
    gain = observer_gain(
        form.A / rate,
        form.C,
        ObservableSplit(seen, hidden, list(form.decisions)),
        sampled=bool(dt),
        process=np.eye(len(A)),
        measurement=np.eye(len(C)),
        poles=None if poles is None else poles / rate,
        margin=margin and margin * (dt or 1 / rate),
        rate=rate,
        tolerance=tolerance,
    )
    if gain.note:
        raise AccuracyError(
            f"no gain found with every observable pole beyond the margin {margin:.3g} per second "
            f"({k} observable states); ask for a smaller margin or add a sensor"
        )
    block = seen.T @ (form.A - rate * gain.K @ form.C) @ seen
    K = rate * form.states[:, None] * gain.K * form.outputs
    K = K @ C @ np.linalg.pinv(C) if np.linalg.matrix_rank(form.C) < len(C) else K
    return Placement(K, rate * gain.requested, rate * gain.poles, fixed, gain.error, block, spectral_norm(K))
