"""Lower bounds of the gain over boxes of members and frequencies: a Taylor polynomial and its remainder."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.robust.sets.uncertain_system import UncertainSystem
from residua.tolerances import RESPONSE_ROUNDING

Real = NDArray[np.float64]
#: Real where every frequency is zero.
Array = NDArray
#: Modal coordinates are used up to this condition of the eigenvectors, those of Schur beyond.
_ILL_CONDITIONED = 1e4
#: The tail is enlarged by this fraction, and not trusted where rounding may exceed it.
_UNRELIABLE = 1e-3


@dataclass(frozen=True, eq=False)
class MemberResponse:
    """An uncertain system in units of states of its own, evaluated at points ``(parameters, theta)``.

    ``theta`` is rad/s for continuous systems and rad/sample for sampled ones, the last coordinate of every point.
    Sampled systems are held as ``A - I``, seen from ``z - 1``: these cancel where poles lie near one, exactly.

    Attributes
    ----------
    A, Bp, Bw, Cq, Cz, Dzp, Dzw : ndarray
    owners : ndarray of int
        The parameter of each channel.
    parameters : tuple of str
    dt : float
    constant : bool
        Whether only ``theta = 0`` is asked for: everything is real then.
    """

    A: Array
    Bp: Array
    Bw: Array
    Cq: Array
    Cz: Array
    Dzp: Array
    Dzw: Array
    owners: NDArray[np.intp]
    parameters: tuple[str, ...]
    dt: float
    constant: bool

    @property
    def origin(self) -> float:
        """Origin of the variable: one for ``z`` of sampled systems, zero for ``s``."""
        return 1.0 if self.dt else 0.0

    def variable(self, theta: NDArray[np.float64]) -> Array:
        """Return ``s`` or ``z - 1`` at frequencies."""
        if self.constant:
            return np.zeros(theta.shape)
        return np.expm1(1j * theta) if self.dt else 1j * theta

    def members(self, values: NDArray[np.float64]) -> tuple[Array, Array]:
        """Return ``A``, less one where sampled, and ``C`` of members, shapes (count, n, n) and (count, p, n)."""
        F = values[:, self.owners][:, :, None] * self.Cq
        return self.A + self.Bp @ F, self.Cz + self.Dzp @ F

    def gains(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the smallest singular value at every point; infinite where a pole is in the way."""
        A, C = self.members(points[:, :-1])
        M = self.variable(points[:, -1])[:, None, None] * np.eye(len(self.A)) - A
        T = C @ solved(M, np.broadcast_to(self.Bw, (len(M), *self.Bw.shape))) + self.Dzw
        fine = np.all(np.isfinite(T), axis=(1, 2))
        if T.shape[2] == 1:
            sizes = np.linalg.norm(T[:, :, 0], axis=1)
        else:
            sizes = np.linalg.svd(np.where(fine[:, None, None], T, 0.0), compute_uv=False)[:, -1]
        return np.where(fine, sizes, np.inf)

    def slopes(self, point: NDArray[np.float64]) -> tuple[Array, Array, float]:
        """Return the weakest column of the response, its slopes along every coordinate, and its rounding.

        The weakest column is ``T v`` for the unit input ``v`` with the smallest output; shapes (p,) and (p, q).
        """
        (A,), (C,) = self.members(point[None, :-1])
        z = self.variable(point[-1:])[0]
        R = np.linalg.inv(z * np.eye(len(A)) - A)
        B, D = self.Bw, self.Dzw
        T = C @ R @ B + D
        U, _, Vh = np.linalg.svd(T)
        v, weak = Vh[-1].conj(), U[:, len(Vh) - 1 :].conj().T
        x = R @ (B @ v)
        to_output = C @ R @ self.Bp + self.Dzp
        slopes = np.zeros((len(T), len(point)), dtype=complex)
        np.add.at(slopes.T, self.owners, (to_output * (self.Cq @ x)).T)
        if not self.constant:
            slopes[:, -1] = -(1j * (z + self.origin) if self.dt else 1j) * (C @ (R @ x))
        # of every input alone: the weakest combination of them is where they cancel
        size, states = np.abs(v), np.abs(R @ B) @ np.abs(v)
        terms = np.abs(C @ R) @ ((abs(z) + np.abs(A)) @ states + np.abs(B) @ size) + np.abs(C) @ states
        return weak @ (T @ v), weak @ slopes, RESPONSE_ROUNDING * float(np.linalg.norm(terms + np.abs(D) @ size))


def member_response(system: UncertainSystem, *, constant: bool) -> MemberResponse:
    """Return a system in balanced units of its states, with the signals that the parameters read in units of these."""
    T = system.balanced_states()
    seen = np.linalg.norm(system.Cq * T, axis=1)[:, None]
    unit = np.where(seen > 0, seen, 1.0)
    return MemberResponse(
        (system.A - float(system.dt > 0) * np.eye(len(T))) / T[:, None] * T,
        system.Bp / T[:, None] * unit.T,
        system.Bw / T[:, None],
        system.Cq * T / unit,
        system.Cz * T,
        system.Dzp * unit.T,
        system.Dzw,
        np.array(system.channels, dtype=int),
        system.parameters,
        system.dt,
        constant,
    )


def solved(M: Array, B: Array) -> Array:
    """Return ``M^-1 B`` for stacks of matrices; infinite where ``M`` is singular."""
    try:
        return np.linalg.solve(M, B)
    except np.linalg.LinAlgError:
        if len(M) == 1:
            return np.full(B.shape, np.inf, dtype=np.result_type(M, B))
        return np.concatenate([solved(M[i : i + 1], B[i : i + 1]) for i in range(len(M))])


@dataclass(frozen=True, eq=False)
class Expansion:
    """Bounds of the gain over each of a stack of boxes.

    Attributes
    ----------
    bound : ndarray, shape (boxes,)
        No point of the box has a smaller gain.
    resolved : ndarray of bool, shape (boxes,)
        Whether it is shown that no member has a pole at a frequency of the box; the bound is 0 otherwise.
    gain : ndarray, shape (boxes,)
        Attained at the centre.
    end : ndarray of int, shape (boxes, coordinates)
        -1 or 1 where the gain is smallest at the lower or upper end of a coordinate, whatever the others are; else 0.
    share : ndarray, shape (boxes, coordinates)
        About what each coordinate adds to the distance of the bound from the smallest gain.
    """

    bound: Real
    resolved: NDArray[np.bool_]
    gain: Real
    end: NDArray[np.intp]
    share: Real


def expand(response: MemberResponse, low: Real, high: Real) -> Expansion:
    r"""Bound the smallest singular value over boxes of points ``(parameters, theta)``, shapes (boxes, coordinates).

    Of one input, :math:`|T|^2` is expanded to second order in the deviations, where the channels of one parameter add
    with their signs; the rest is bounded by absolute values. The slopes of the gain are bounded in the same way: one
    that keeps its sign over the box leaves one end of a coordinate to look at.

    Several inputs are bounded by the norm of the inverse, :math:`1/|(U^H T)^{-1}|_2`, of which the weakest input is the
    largest part; ``U`` are the left singular vectors of the centre, as many as there are inputs. With the right ones as
    a basis :math:`v_j`, the products :math:`(T v_j)^H (T v_k)` are zero at the centre, and bounded.
    """
    c = centre(response, low, high)
    t = series(c)
    inputs = c.T.shape[2]
    gain, resolved, weight = c.T[:, inputs - 1, -1], t.resolved, t.weight
    c, t = (c, t) if inputs == 1 else (inverse(c), series(inverse(c)))
    squares, gradient, hessian = _squares(c, t, -1 if inputs == 1 else 1)
    slack = _slack(c, t, hessian)
    share, end = c.radii * slack, np.zeros(low.shape)
    if inputs == 1:
        bound, end = np.sqrt(np.maximum(squares[:, 0], 0.0)), np.where(np.abs(gradient) > slack, -np.sign(gradient), 0)
    else:
        bound = t.resolved / np.sqrt(_largest_eigenvalue(squares, _mixed(c, t)))
        share = np.where(t.resolved[:, None], share, t.weight)
    end, share = (np.where(resolved[:, None], one, other) for one, other in ((end, 0), (share, weight)))
    return Expansion(bound * resolved, resolved, gain, end.astype(int), share)


def _squares(c: Centre, t: Series, sign: int) -> tuple[Real, Real, Real]:
    """Return bounds of ``|T v_j|^2``, upper or lower, and half of gradient and Hessian of the last at the centre."""
    diagonal = np.arange(c.T.shape[2])
    s, d = c.T[:, diagonal, diagonal], c.radii
    gradient = s[:, :, None] * np.real(t.first[:, diagonal, diagonal])
    hessian = np.real(t.first.conj().transpose(0, 2, 3, 1) @ t.first.swapaxes(1, 2))
    hessian = hessian + s[:, :, None, None] * np.real(t.second[:, diagonal, diagonal])
    third = (2 * c.T * t.third + 2 * t.one * t.more + t.more**2).sum(axis=1)
    lost = ((2 * (c.T + t.one + t.more) + t.rounding) * t.rounding).sum(axis=1)
    # 2 g'e + e'He for |e_i| <= d_i is no smaller than this, and exact for diagonal H
    H, slope, wide = -sign * hessian, np.abs(gradient), d[:, None, :]
    bend = np.diagonal(H, axis1=2, axis2=3)
    inside = bend * wide > slope
    alone = np.where(inside, -(slope**2) / np.where(inside, bend, 1.0), (bend * wide - 2 * slope) * wide)
    beside = (np.abs(H) @ wide[..., None])[..., 0] * wide - np.abs(bend) * wide * wide
    change = (beside - alone).sum(axis=2)
    return s * s + sign * (change + third + lost), gradient[:, -1], hessian[:, -1]


def _mixed(c: Centre, t: Series) -> Real:
    """Return upper bounds of ``|(T v_j)^H (T v_k)|``, j != k."""
    diagonal = np.arange(c.T.shape[2])
    s, top = c.T[:, diagonal, diagonal], t.first[:, diagonal]
    first = np.abs(s[:, :, None, None] * top + s[:, None, :, None] * top.swapaxes(1, 2).conj())
    more = t.more + t.rounding
    once = s[:, :, None] * (more + t.rounding)[:, diagonal]
    bounds = (first * c.radii[:, None, None, :]).sum(axis=3) + once + once.swapaxes(1, 2)
    bounds = bounds + (t.one + more).swapaxes(1, 2) @ (t.one + more)
    bounds[:, diagonal, diagonal] = 0.0
    return bounds


def _slack(c: Centre, t: Series, hessian: Real) -> Real:
    """Bound the change over the box of half the slopes of ``|T v|^2``, ``v`` the weakest input of the centre."""
    T, first = c.T[:, :, -1, None], np.abs(t.first[:, :, -1])
    one, more, rounding = (part[:, :, -1, None] for part in (t.one, t.more, t.rounding))
    slope_one, slope_rest = t.slope_one[:, :, -1], t.slope_rest[:, :, -1]
    slopes = first + slope_one + slope_rest
    rest = T * slope_rest + one * (slope_one + slope_rest) + more * slopes
    unsure = (rounding + 16 * c.relative[:, None, None] * (T + one + more)) * slopes
    return (np.abs(hessian) @ c.radii[:, :, None])[:, :, 0] + (rest + unsure).sum(axis=1)


def _largest_eigenvalue(squares: Real, mixed: Real) -> Real:
    """Return an upper bound of the eigenvalues of Hermitian matrices: the largest ``(S x)_j / x_j``, any ``x > 0``."""
    S = squares[:, :, None] * np.eye(squares.shape[1]) + mixed
    x = np.ones(squares.shape)
    for _ in range(8):
        x = (S @ x[:, :, None])[:, :, 0]
        x = np.maximum(x / x.max(axis=1, keepdims=True), 1e-12)
    return ((S @ x[:, :, None])[:, :, 0] / x).max(axis=1)


@dataclass(frozen=True, eq=False)
class Centre:
    r"""Linear-fractional forms around the centres of boxes, seen along the singular vectors there.

    .. math:: U^H T V = T_c + M_{12} E (I - M_{22} E)^{-1} M_{21}

    with a diagonal ``E`` of real deviations, each of one or more channels.

    Attributes
    ----------
    T : ndarray, shape (boxes, p, m)
        Singular values on the diagonal.
    M12, M22, M21 : ndarray
    radii : ndarray, shape (boxes, coordinates)
        The largest deviations.
    select : ndarray, shape (channels, coordinates)
        1 where a channel belongs to a coordinate.
    error : ndarray, shape (boxes, p, m)
        Rounding of ``T``.
    relative : ndarray, shape (boxes,)
        Relative rounding of the others.
    """

    T: Real
    M12: Array
    M22: Array
    M21: Array
    radii: Real
    select: Real
    error: Real
    relative: Real


def centre(response: MemberResponse, low: Real, high: Real) -> Centre:
    """Return the forms of boxes of points ``(parameters, theta)``, shapes (boxes, coordinates).

    Frequency is a parameter with a channel for each state, which takes all points of the arc: with
    ``z = z_c (1 + jt) / (1 - jt)``, ``t = tan(theta/2)`` of the deviation ``theta``, ``z x = z_c x + 2j z_c t xi`` and
    ``xi = x + jt xi``. In continuous time ``s = s_c + jt``.
    """
    middle, radii = (low + high) / 2, (high - low) / 2
    values, n = middle[:, :-1], len(response.A)
    A, C = response.members(values)
    z = response.variable(middle[:, -1])[:, None, None]
    R = solved(z * np.eye(n) - A, np.broadcast_to(np.eye(n), A.shape))
    regular = np.all(np.isfinite(R), axis=(1, 2))
    R = np.where(regular[:, None, None], R, 0.0)
    U, s, Vh = np.linalg.svd(C @ R @ response.Bw + response.Dzw)
    U, V = U.conj().swapaxes(1, 2), Vh.conj().swapaxes(1, 2)
    T = np.zeros((len(low), U.shape[1], s.shape[1]))
    T[:, np.arange(s.shape[1]), np.arange(s.shape[1])] = s
    left, right = U @ C @ R, R @ response.Bw @ V
    F = np.abs(values[:, response.owners])[:, :, None] * np.abs(response.Cq)
    size = np.abs(response.A) + np.abs(response.Bp) @ F + np.abs(z) * np.eye(n)
    error = np.abs(left) @ (size @ np.abs(right) + np.abs(response.Bw @ V)) + np.abs(U @ C) @ np.abs(right)
    relative = (np.abs(R) @ size).sum(axis=2).max(axis=1, initial=1.0)
    select = np.eye(low.shape[1])[response.owners]
    M12, M21, M22 = left @ response.Bp + U @ response.Dzp, response.Cq @ right, response.Cq @ R @ response.Bp
    if not response.constant and n:
        # with eigenvectors, or Schur vectors where those are too much alike, the resolvent is about diagonal
        basis = np.linalg.eig(A)[1].astype(complex)
        for i in np.flatnonzero(~(np.linalg.cond(basis) < _ILL_CONDITIONED)):
            basis[i] = scipy.linalg.schur(A[i], output="complex")[1]
        back = np.linalg.inv(basis)
        factor = -2j * (z + 1) if response.dt else -1j
        driven, seen = factor * R @ basis, back @ R @ response.Bp
        modal = back @ driven + (1j * np.eye(n) if response.dt else 0)
        upper = np.concatenate([M22, response.Cq @ driven], axis=2)
        M22 = np.concatenate([upper, np.concatenate([seen, modal], axis=2)], axis=1)
        M12 = np.concatenate([M12, factor * left @ basis], axis=2)
        M21 = np.concatenate([M21, back @ right], axis=1)
        select = np.vstack([select, np.repeat(np.eye(low.shape[1])[-1:], n, axis=0)])
        relative = relative + np.linalg.norm(basis, axis=(1, 2)) * np.linalg.norm(back, axis=(1, 2))
        if response.dt:
            radii[:, -1] = np.tan(radii[:, -1] / 2)
    relative = np.where(regular, RESPONSE_ROUNDING * relative, 1.0)
    return Centre(T, M12, M22, M21, radii, select, RESPONSE_ROUNDING * (error + np.abs(U @ response.Dzw @ V)), relative)


def inverse(c: Centre) -> Centre:
    """Return the form of the inverse of the first rows, as many as there are columns; unreliable if there is none.

    The smallest singular value of those is not above that of all.
    """
    m = c.T.shape[2]
    s = c.T[:, np.arange(m), np.arange(m)]
    exists = s[:, -1:] > RESPONSE_ROUNDING / _UNRELIABLE * s[:, :1]
    s = np.where(exists, s, 1.0)
    M12, M21 = c.M12[:, :m] / s[:, :, None], c.M21 / s[:, None, :]
    return Centre(
        np.eye(m) / s[:, None, :],
        -M12,
        c.M22 - c.M21 @ M12,
        M21,
        c.radii,
        c.select,
        c.error[:, :m] / s[:, :, None] / s[:, None, :],
        np.where(exists[:, 0], c.relative * (1 + s[:, 0] / s[:, -1]), 1.0),
    )


@dataclass(frozen=True, eq=False)
class Series:
    """Terms of the response, ``T = T_c + sum first_i e_i + 1/2 sum second_il e_i e_l + ...``, and bounds of them.

    Attributes
    ----------
    first : ndarray, shape (boxes, p, m, coordinates)
    second : ndarray, shape (boxes, p, m, coordinates, coordinates)
    one, more, third : ndarray, shape (boxes, p, m)
        Of all terms of the first order, from the second, from the third order on.
    slope_one, slope_rest : ndarray, shape (boxes, p, m, coordinates)
        Of what the slopes along each coordinate differ by from the centre's: to first order, and beyond.
    rounding : ndarray, shape (boxes, p, m)
        Of the response and its terms.
    resolved : ndarray of bool, shape (boxes,)
        Whether the series converges all over the box; else nothing else holds.
    weight : ndarray, shape (boxes, coordinates)
        About how much each coordinate is to blame if it does not; 0 where rounding is.
    """

    first: Array
    second: Array
    one: Real
    more: Real
    third: Real
    slope_one: Real
    slope_rest: Real
    rounding: Real
    resolved: NDArray[np.bool_]
    weight: Real


def series(c: Centre) -> Series:
    """Expand to second order, and bound the rest by the same series of absolute values."""
    boxes, p, m = c.T.shape
    q = c.select.shape[1]
    rows = (c.M12[:, :, None, :] * c.select.T).reshape(boxes, p * q, -1)
    columns = (c.M21[:, :, :, None] * c.select[:, None, :]).reshape(boxes, -1, m * q)
    first = (rows @ c.M21).reshape(boxes, p, q, m).swapaxes(2, 3)
    second = (rows @ c.M22 @ columns).reshape(boxes, p, q, m, q).swapaxes(2, 3)
    second = second + second.swapaxes(3, 4)
    b, N, a = np.abs(c.M12), np.abs(c.M22), np.abs(c.M21)
    D = (c.radii @ c.select.T)[:, None, :]
    P, bD = N * D, b * D
    inverse, resolved = _neumann(P, c.relative)
    X, Y = inverse @ a, b + bD @ inverse @ N
    X1, X2, Y1, Y2 = P @ a, P @ (P @ X), bD @ N, ((Y * D) @ N * D) @ N
    third = bD @ X2
    # for every output, input and channel
    per_channel = sum(
        rows[:, :, None, :] * columns.swapaxes(1, 2)[:, None] for rows, columns in ((b, X2), (Y1, X1 + X2), (Y2, X))
    )
    slope_one = (np.abs(second) @ c.radii[:, None, None, :, None])[..., 0]
    more = (slope_one @ c.radii[:, None, :, None])[..., 0] / 2 + third
    return Series(
        first,
        second,
        (np.abs(first) @ c.radii[:, None, :, None])[..., 0],
        more,
        third,
        slope_one,
        per_channel @ c.select,
        c.error + 8 * c.relative[:, None, None] * (bD @ X),
        resolved,
        np.where(c.relative < _UNRELIABLE, 1.0, 0.0)[:, None] * ((P.sum(axis=1) + P.sum(axis=2)) @ c.select),
    )


def _neumann(P: Real, relative: Real) -> tuple[Real, NDArray[np.bool_]]:
    """Return ``(I - P)^-1``, a little enlarged, and where the spectral radius of ``P`` is proved to be below one."""
    one = np.eye(P.shape[1])
    inverse = solved(one - P, np.broadcast_to(one, P.shape))
    x = inverse.sum(axis=2)
    finite = np.isfinite(x).all(axis=1)
    x = np.where(finite[:, None], x, 0.0)
    # A positive x with x > P x is the proof; the difference is 1 but for rounding.
    proved = finite & (x > 0).all(axis=1) & (x - (P @ x[:, :, None])[:, :, 0] > 0.5).all(axis=1)
    proved &= relative * x.max(axis=1, initial=1.0) < _UNRELIABLE
    inverse = (1 + _UNRELIABLE) * np.abs(inverse)
    return np.where(proved[:, None, None], inverse, one), proved
