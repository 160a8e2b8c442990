"""The response of the members of a box as a series in their deviations from the centre, with bounds of its tail."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.robust.bounds.member_response import Array, MemberResponse, solved
from residua.tolerances import RESPONSE_ROUNDING

Real = NDArray[np.float64]
#: Modal coordinates are used up to this condition of the eigenvectors, those of Schur beyond.
_ILL_CONDITIONED = 1e4
#: The tail is enlarged by this fraction, and not trusted where rounding may exceed it.
_UNRELIABLE = 1e-3
_SWEEPS = 10


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
    """Return the forms of boxes of points ``(parameters, theta)``, shapes (boxes, coordinates)."""
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
        M12, M22, M21, condition = _with_frequency(
            response, (A, z + response.origin, R), (M12, M22, M21), (left, right)
        )
        select = np.vstack([select, np.repeat(np.eye(low.shape[1])[-1:], n, axis=0)])
        relative = relative + condition
        if response.dt:
            radii[:, -1] = np.tan(radii[:, -1] / 2)
    relative = np.where(regular, RESPONSE_ROUNDING * relative, 1.0)
    return Centre(T, M12, M22, M21, radii, select, RESPONSE_ROUNDING * (error + np.abs(U @ response.Dzw @ V)), relative)


def _with_frequency(
    response: MemberResponse, state: tuple[Array, Array, Array], M: tuple[Array, ...], ends: tuple[Array, Array]
) -> tuple[Array, Array, Array, Real]:
    """Append frequency as a parameter with a channel for each state, which takes all points of the arc.

    With ``z = z_c (1 + jt) / (1 - jt)``, ``t = tan(theta/2)`` of the deviation ``theta``, ``z x = z_c x + 2j z_c t xi``
    and ``xi = x + jt xi``. In continuous time ``s = s_c + jt``. In coordinates that make the resolvent about diagonal.
    """
    A, z, R = state
    (M12, M22, M21), (left, right) = M, ends
    sampled = response.dt > 0
    basis, back = _resolvent_basis(A)
    factor = -2j * z if sampled else -1j
    driven, seen = factor * R @ basis, back @ R @ response.Bp
    own = back @ driven + (1j * np.eye(len(response.A)) if sampled else 0)
    upper = np.concatenate([M22, response.Cq @ driven], axis=2)
    lower = np.concatenate([seen, own], axis=2)
    condition = np.linalg.norm(basis, axis=(1, 2)) * np.linalg.norm(back, axis=(1, 2))
    return (
        np.concatenate([M12, factor * left @ basis], axis=2),
        np.concatenate([upper, lower], axis=1),
        np.concatenate([M21, back @ right], axis=1),
        condition,
    )


def _resolvent_basis(A: Array) -> tuple[Array, Array]:
    """Return eigenvectors, or Schur vectors where those are too much alike, and the inverses."""
    basis = np.linalg.eig(A)[1].astype(complex)
    for i in np.flatnonzero(~(np.linalg.cond(basis) < _ILL_CONDITIONED)):
        basis[i] = scipy.linalg.schur(A[i], output="complex")[1]
    return basis, np.linalg.inv(basis)


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
    first, second = _terms(c)
    b, N, a = np.abs(c.M12), np.abs(c.M22), np.abs(c.M21)
    D = (c.radii @ c.select.T)[:, None, :]
    P, bD = N * D, b * D
    inverse, resolved = _neumann(P, c.relative)
    X, Y = inverse @ a, b + bD @ inverse @ N
    X1, X2, Y1, Y2 = P @ a, P @ (P @ X), bD @ N, ((Y * D) @ N * D) @ N
    third = bD @ X2
    per_channel = _outer(b, X2) + _outer(Y1, X1 + X2) + _outer(Y2, X)
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
        np.where(c.relative < _UNRELIABLE, 1.0, 0.0)[:, None] * (_spectral_weights(P) @ c.select),
    )


def _terms(c: Centre) -> tuple[Array, Array]:
    boxes, p, m = c.T.shape
    q = c.select.shape[1]
    left = (c.M12[:, :, None, :] * c.select.T).reshape(boxes, p * q, -1)
    right = (c.M21[:, :, :, None] * c.select[:, None, :]).reshape(boxes, -1, m * q)
    first = (left @ c.M21).reshape(boxes, p, q, m).swapaxes(2, 3)
    second = (left @ c.M22 @ right).reshape(boxes, p, q, m, q).swapaxes(2, 3)
    return first, second + second.swapaxes(3, 4)


def _outer(rows: Real, columns: Real) -> Real:
    """Return products for every output, input and channel, shape (boxes, p, m, channels)."""
    return rows[:, :, None, :] * columns.swapaxes(1, 2)[:, None]


def _neumann(P: Real, relative: Real) -> tuple[Real, NDArray[np.bool_]]:
    """Return ``(I - P)^-1``, a little enlarged, and where the spectral radius of ``P`` is proved to be below one."""
    one, unit = np.eye(P.shape[1]), _channel_units(P)
    P = P / unit[:, :, None] * unit[:, None, :]
    inverse = solved(one - P, np.broadcast_to(one, P.shape))
    x = inverse.sum(axis=2)
    finite = np.isfinite(x).all(axis=1)
    x = np.where(finite[:, None], x, 0.0)
    # A positive x with x > P x is the proof; the difference is 1 but for rounding.
    proved = finite & (x > 0).all(axis=1) & (x - (P @ x[:, :, None])[:, :, 0] > 0.5).all(axis=1)
    proved &= relative * x.max(axis=1, initial=1.0) < _UNRELIABLE
    inverse = (1 + _UNRELIABLE) * np.abs(inverse) * unit[:, :, None] / unit[:, None, :]
    return np.where(proved[:, None, None], inverse, one), proved


def _channel_units(P: Real) -> Real:
    """Return units in which the rows and columns of nonnegative matrices are about even."""
    unit = np.ones(P.shape[:2])
    for _ in range(_SWEEPS):
        scaled = P / unit[:, :, None] * unit[:, None, :]
        rows, columns = scaled.sum(axis=2), scaled.sum(axis=1)
        both = (rows > 0) & (columns > 0)
        ratio = np.where(both, rows, 1.0) / np.where(both, columns, 1.0)
        unit = unit * np.clip(ratio, 1e-12, 1e12) ** 0.25
    return unit


def _spectral_weights(P: Real) -> Real:
    """Return products of right and left eigenvectors for the spectral radius, about."""
    right = left = np.ones(P.shape[:2])
    tiny = np.finfo(float).tiny
    for _ in range(12):
        right = (P @ right[:, :, None])[:, :, 0] + 1e-3 * right
        left = (left[:, None, :] @ P)[:, 0] + 1e-3 * left
        right = right / np.maximum(right.max(axis=1, keepdims=True, initial=0.0), tiny)
        left = left / np.maximum(left.max(axis=1, keepdims=True, initial=0.0), tiny)
    return right * left
