"""What the gain exceeds over boxes of members and frequencies: a Taylor polynomial around the centre, and its rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.robust.bounds.member_response import MemberResponse, solved
from residua.robust.bounds.response_series import Centre, Series, centre, inverse, series

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Expansion:
    """What is known about the gain over each of a stack of boxes.

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

    With the right singular vectors :math:`v_j` of the centre as a basis, the squares :math:`|T v_j|^2` are expanded
    to second order in the deviations, where the channels of one parameter add with their signs; the rest, and the
    products :math:`(T v_j)^H (T v_k)`, which are zero at the centre, are bounded by absolute values. The slopes of the
    gain are bounded in the same way: one that keeps its sign over the box leaves one end of a coordinate to look at.

    Several inputs are also bounded by the norm of the inverse, :math:`1/|(U^H T)^{-1}|_2`, of which the weakest input
    is the largest part; ``U`` are the left singular vectors of the centre, as many as there are inputs.
    """
    c = centre(response, low, high)
    t = series(c)
    outputs, inputs = c.T.shape[1:]
    bound, slope, slack, share = _from_squares(c, t)
    end = np.where(np.abs(slope) > slack, -np.sign(slope), 0)
    if inputs > 1:
        other, slope, slack = _from_inverse(c)
        bound = np.maximum(bound, other)
        if outputs == inputs:  # else the slopes are those of U^H T, and not of the gain
            end = np.where((end == 0) & (np.abs(slope) > slack), np.sign(slope), end)
    known = t.resolved[:, None]
    share = np.where(known, share, t.weight)
    return Expansion(bound * t.resolved, t.resolved, c.T[:, inputs - 1, -1], np.where(known, end, 0).astype(int), share)


def _from_squares(c: Centre, t: Series) -> tuple[Real, Real, Real, Real]:
    """Return lower bounds of the gain, its slopes at the centre and their changes, and shares of coordinates."""
    squares, gradient, hessian = _squares(c, t, -1)
    mixed, first = _mixed(c, t)
    slack = _slack(c, t, hessian)
    if c.T.shape[2] == 1:
        return np.sqrt(np.maximum(squares[:, 0], 0.0)), gradient, slack, c.radii * slack
    highest = ((c.T + t.one + t.more + t.rounding)[:, :, -1] ** 2).sum(axis=1)
    room = _least_eigenvalue(squares[:, :-1], mixed[:, :-1, :-1]) - highest
    apart = np.maximum(squares - squares[:, -1:], mixed[:, -1] + np.finfo(float).tiny)
    crossed = np.einsum("bj,bji->bi", mixed[:, -1] / apart, first[:, -1])
    bound = np.sqrt(_least_eigenvalue(squares, mixed))
    return bound, gradient, slack + _tilt(c, t, room, mixed), c.radii * slack + crossed


def _from_inverse(c: Centre) -> tuple[Real, Real, Real]:
    """Return lower bounds of the gain from the inverse, and slopes of that, positive where the gain falls."""
    c = inverse(c)
    t = series(c)
    squares, gradient, hessian = _squares(c, t, 1)
    mixed, _ = _mixed(c, t)
    room = _squares(c, t, -1)[0][:, -1] - _largest_eigenvalue(squares[:, :-1], mixed[:, :-1, :-1])
    slack = _slack(c, t, hessian) + _tilt(c, t, room, mixed)
    bound = t.resolved / np.sqrt(_largest_eigenvalue(squares, mixed))
    return bound, gradient, np.where(t.resolved[:, None], slack, np.inf)


def _squares(c: Centre, t: Series, sign: int) -> tuple[Real, Real, Real]:
    """Return bounds of ``|T v_j|^2``, upper or lower, and half of gradient and Hessian of the last at the centre."""
    own = np.arange(c.T.shape[2])
    s, d = c.T[:, own, own], c.radii
    gradient = s[:, :, None] * np.real(t.first[:, own, own])
    hessian = np.real(t.first.conj().transpose(0, 2, 3, 1) @ t.first.swapaxes(1, 2))
    hessian = hessian + s[:, :, None, None] * np.real(t.second[:, own, own])
    third = (2 * c.T * t.third + 2 * t.one * t.more + t.more**2).sum(axis=1)
    lost = ((2 * (c.T + t.one + t.more) + t.rounding) * t.rounding).sum(axis=1)
    change = -_least_quadratic(gradient, -sign * hessian, d)
    return s * s + sign * (change + third + lost), gradient[:, -1], hessian[:, -1]


def _least_quadratic(gradient: Real, hessian: Real, d: Real) -> Real:
    """Return a lower bound of ``2 g'e + e'He`` for ``|e_i| <= d_i``, for every column; exact for diagonal ``H``."""
    d = d[:, None, :]
    bend, slope = np.diagonal(hessian, axis1=2, axis2=3), np.abs(gradient)
    inside = bend * d > slope
    alone = np.where(inside, -(slope**2) / np.where(inside, bend, 1.0), (bend * d - 2 * slope) * d)
    beside = (np.abs(hessian) @ d[..., None])[..., 0] * d - np.abs(bend) * d * d
    return (alone - beside).sum(axis=2)


def _mixed(c: Centre, t: Series) -> tuple[Real, Real]:
    """Return upper bounds of ``|(T v_j)^H (T v_k)|``, j != k, and the part of each coordinate to first order."""
    own = np.arange(c.T.shape[2])
    s = c.T[:, own, own]
    top = t.first[:, own]
    first = np.abs(s[:, :, None, None] * top + s[:, None, :, None] * top.swapaxes(1, 2).conj())
    first = first * c.radii[:, None, None, :]
    more = t.more + t.rounding
    once = s[:, :, None] * (more + t.rounding)[:, own]
    bounds = first.sum(axis=3) + once + once.swapaxes(1, 2) + (t.one + more).swapaxes(1, 2) @ (t.one + more)
    bounds[:, own, own], first[:, own, own] = 0.0, 0.0
    return bounds, first


def _least_eigenvalue(squares: Real, mixed: Real) -> Real:
    """Return a lower bound of the eigenvalues of Hermitian matrices; 0 where none is positive.

    With diagonals of at least ``squares`` and entries beside them of at most ``mixed``, the least eigenvalue of
    ``S = diag(squares) - mixed`` is a bound; of it, for any positive ``x``, the least ``(S x)_j / x_j``.
    """
    m = squares.shape[1]
    good = np.all(squares > 0, axis=1)
    S = np.where(good[:, None, None], squares[:, :, None] * np.eye(m) - mixed, np.eye(m))
    x = np.ones(squares.shape)
    for _ in range(6):
        x = solved(S, x[:, :, None])[:, :, 0]
        good &= np.all((x > 0) & np.isfinite(x), axis=1)
        x = np.maximum(np.where(good[:, None], x, 1.0), 1e-12 * np.abs(x).max(axis=1, keepdims=True))
        x = np.where(good[:, None], x / x.max(axis=1, keepdims=True), 1.0)
    return np.where(good, np.maximum(((S @ x[:, :, None])[:, :, 0] / x).min(axis=1), 0.0), 0.0)


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


def _tilt(c: Centre, t: Series, room: Real, mixed: Real) -> Real:
    """Bound how much the weakest input's turning within the box changes the slopes; infinite where nothing is known.

    That of a member is ``v + y``, ``y`` in the span of the others: an eigenvector of ``G = T^H T``, of which
    ``(G - lambda) y = -g`` is the part that belongs to them. ``room`` is how far their eigenvalues are from ``lambda``.
    """
    size = c.T + t.one + t.more + t.rounding
    slopes = np.abs(t.first) + t.slope_one + t.slope_rest
    turned = (np.linalg.norm(mixed[:, :-1, -1], axis=1) / np.where(room > 0, room, 1.0))[:, None]
    changes = np.einsum("brji,brk->bijk", slopes, size)
    changes = (changes + changes.swapaxes(2, 3)) / 2
    once = np.linalg.norm(changes[:, :, :-1, -1], axis=2)
    twice = np.linalg.norm(changes[:, :, :-1, :-1], axis=(2, 3))
    return np.where(room[:, None] > 0, 2 * turned * once + turned**2 * twice, np.inf)
