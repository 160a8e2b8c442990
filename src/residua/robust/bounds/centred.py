r"""Bounds around the centre of the set: exact to first order, nearly to second, and small gains for the rest.

With :math:`F = F_c + \Phi`, ``T_zw`` and so on from the centre, and :math:`q` what the parameters see,

.. math::

   z = T_{zw} w + T_{zp} \Phi T_{qw} w + T_{zp} \Phi T_{qp} \Phi T_{qw} w
       + T_{zp} \Phi T_{qp} \Phi \, (q - T_{qw} w), \qquad
   q - T_{qw} w = T_{qp} \Phi T_{qw} w + T_{qp} \Phi \, (q - T_{qw} w)

The first two terms are linear in the parameters, so that their norm is largest at a corner, where it is computed. Of
the third, the norm of each product of two parameters is computed. The last is small of third order. Gains from peak to
peak bound it, and the second equation is solved for them: possible if the matrix of the gains, times the half widths of
the parameters, has a spectral radius below one; that also proves every member stable.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.norms.impulse_terms import StableSystem, impulse_blocks, response_blocks
from residua.linear.norms.peak_direction import largest_sum
from residua.linear.norms.peak_norm import peak_norm
from residua.linear.poles.spectrum import spectral_radius
from residua.robust.bounds.reached_middle import ReachedMiddle, reached_middle
from residua.robust.sets.uncertain_system import UncertainSystem
from residua.tolerances import RESPONSE_ROUNDING

Matrix = NDArray[np.float64]
Real = NDArray[np.float64]
#: What is cut off of the impulse responses, in units of what is reached; and from where on there is no bound by them.
_TAIL, _LARGEST_TAIL = 1e-8, 1e-3
#: Terms of impulse responses that are computed, and numbers of them that are kept.
_TERMS, _STORED = 1_000_000, 20_000_000
#: Parameters whose corners are visited, for one output and for several; of others the norms are added.
_CORNERS, _CORNERS_OF_MANY = 10, 4
#: Numbers of the responses at corners that are held at a time.
_CHUNK = 4_000_000
#: What rounding of sums of responses may do to the bound.
_ROUNDED = 1 + 1e-9


@dataclass(frozen=True, eq=False)
class CentredBound:
    """A bound of the output of all members, and what it consists of.

    Attributes
    ----------
    linear : float
        Of the first two terms.
    second : float
        Of the third.
    rest : float
        Of the last; infinite where small gains prove nothing.
    blame : ndarray, shape (parameters,)
        About what each parameter adds to the last two.
    gain : float
        The spectral radius of the gains around the parameters: below 1 if there is a bound.
    """

    linear: float
    second: float
    rest: float
    blame: Real
    gain: float

    @property
    def value(self) -> float:
        """The bound."""
        return (self.linear + self.second + self.rest) * _ROUNDED


def centred_bound(system: UncertainSystem) -> CentredBound | None:
    """Bound the output of all members for inputs of unit size; None if the responses are too long for it."""
    if not np.any((system.high - system.low)[list(system.channels)]):
        alone = peak_norm(system.member((system.low + system.high) / 2), rtol=1e-4).value
        return CentredBound(alone, 0.0, 0.0, np.zeros(system.n_parameters), 0.0)
    reached = reached_middle(system)
    centre = _centre(system, reached)
    gains = _gains(centre)
    return None if gains is None else _Expansion(system, centre, gains).bound(reached.unit)


@dataclass(frozen=True, eq=False)
class _Centre:
    """The centre of the set, in even units: from inputs ``w`` and channels ``p`` to ``z`` and ``q``."""

    A: Matrix
    Bw: Matrix
    Bp: Matrix
    Cz: Matrix
    Cq: Matrix
    Dzw: Matrix
    Dzp: Matrix
    radius: float


def _centre(system: UncertainSystem, reached: ReachedMiddle) -> _Centre:
    s = reached.middle
    unit = np.where(reached.reach > 0, reached.reach, 1.0)
    return _Centre(
        s.A,
        s.B,
        system.Bp / s.units[:, None] * unit,
        s.C / reached.unit,
        system.Cq * s.units / unit[:, None],
        s.D / reached.unit,
        system.Dzp * unit / reached.unit,
        s.radius,
    )


@dataclass(frozen=True, eq=False)
class _Gains:
    """Norms of the impulse responses of the centre.

    Attributes
    ----------
    zw : ndarray, shape (terms, outputs, inputs)
        The response itself.
    zp, qp : ndarray
        Sums of absolute values, shape (rows, columns).
    qw : ndarray, shape (channels,)
        Sums of lengths.
    tail : float
        No sum over what is cut off is larger, of any entry; it is in the others already.
    """

    zw: Real
    zp: Real
    qp: Real
    qw: Real
    tail: float

    @property
    def terms(self) -> int:
        """How many terms are not cut off."""
        return len(self.zw)


def _gains(c: _Centre) -> _Gains | None:
    p, m = c.Dzw.shape
    k = len(c.Cq)
    B, C = np.hstack([c.Bw, c.Bp]), np.vstack([c.Cz, c.Cq])
    D = np.zeros((p + k, m + k))
    D[:p, :m], D[:p, m:] = c.Dzw, c.Dzp
    zw, zp, qp, qw, tail = [], np.zeros((p, k)), np.zeros((k, k)), np.zeros(k), np.inf
    system = StableSystem(c.A, B, C, D, np.ones(len(c.A)), c.radius)
    for H, tail in impulse_blocks(system, most=min(_TERMS, _STORED // max(p * m * (2 + 2 * k), 1))):
        zw.append(H[:, :p, :m])
        zp += np.abs(H[:, :p, m:]).sum(axis=0)
        qp += np.abs(H[:, p:, m:]).sum(axis=0)
        qw += np.linalg.norm(H[:, p:, :m], axis=2).sum(axis=0)
        if tail <= _TAIL:
            break
    if tail > _LARGEST_TAIL:
        return None
    return _Gains(np.concatenate(zw), zp + tail, qp + tail, qw + tail, tail)


class _Expansion:
    """The terms of the expansion: responses of chains of the centre, each driving the next by way of a parameter."""

    def __init__(self, system: UncertainSystem, centre: _Centre, gains: _Gains) -> None:
        self.c, self.gains = centre, gains
        half = (system.high - system.low) / 2
        self.moving = [i for i in range(len(half)) if half[i] > 0 and i in system.channels]
        self.owned = [np.flatnonzero(np.array(system.channels) == i) for i in self.moving]
        self.half, self.count = half[self.moving], len(half)
        self.width = half[list(system.channels)]
        self.loops = [centre.Bp[:, own] @ centre.Cq[own] for own in self.owned]
        self.directs = [centre.Dzp[:, own] @ centre.Cq[own] for own in self.owned]

    def bound(self, unit: float) -> CentredBound:
        """Return the bound; its parts are infinite where small gains prove nothing."""
        around = self.gains.qp * self.width
        gain = float(spectral_radius(around))
        none = CentredBound(np.inf, np.inf, np.inf, self._weights(around), gain)
        if not gain < 1:
            return none
        first = [self._first(i) for i in range(len(self.moving))]
        seen = [norms for _, norms in first]
        away = _solved(around, sum((h * q for h, q in zip(self.half, seen, strict=True)), np.zeros(len(self.width))))
        if away is None:
            return none
        linear, second = self._linear([z for z, _ in first]), self._second(seen)
        front = sum((h * self._front(i) for i, h in enumerate(self.half)), np.zeros_like(self.gains.zp))
        rest = front * self.width * away
        blame = np.zeros(self.count)
        for i, own, row in zip(self.moving, self.owned, second, strict=True):
            blame[i] = np.linalg.norm(rest[:, own], axis=0).sum() + row.sum()
        both, last = float(np.triu(second).sum()), float(np.linalg.norm(rest.sum(axis=1)))
        return CentredBound(float(unit * linear), float(unit * both), float(unit * last), blame, gain)

    def _first(self, i: int) -> tuple[Real, Real]:
        """Return the response of ``z`` to a parameter, to first order, and the norms of that of ``q``."""
        c, g, own, p = self.c, self.gains, self.owned[i], len(self.c.Cz)
        zero = np.zeros_like(c.A)
        A = np.block([[c.A, zero], [self.loops[i], c.A]])
        C = np.block([[self.directs[i], c.Cz], [np.zeros_like(c.Cq), c.Cq]])
        z, q = [np.zeros((1, *c.Dzw.shape))], np.zeros(len(c.Cq))
        for H, _ in response_blocks(A, np.vstack([c.Bw, np.zeros_like(c.Bw)]), C, 2 * g.terms):
            z.append(H[:, :p])
            q += np.linalg.norm(H[:, p:], axis=2).sum(axis=0)
        missed = g.tail * (g.qw[own].sum() + g.qp[:, own].sum(axis=1)) + RESPONSE_ROUNDING * (g.qp[:, own] @ g.qw[own])
        return np.concatenate(z), q + missed

    def _front(self, i: int) -> Matrix:
        """Return the norms of ``T_zp Phi T_qp`` for one parameter, shape (outputs, channels)."""
        c, g, own = self.c, self.gains, self.owned[i]
        A = np.block([[c.A, np.zeros_like(c.A)], [self.loops[i], c.A]])
        norms = np.zeros_like(g.zp)
        C = np.hstack([self.directs[i], c.Cz])
        for H, _ in response_blocks(A, np.vstack([c.Bp, np.zeros_like(c.Bp)]), C, 2 * g.terms):
            norms += np.abs(H).sum(axis=0)
        tail = g.tail * (g.zp[:, own].sum(axis=1)[:, None] + g.qp[own].sum(axis=0))
        return norms + tail + RESPONSE_ROUNDING * (g.zp[:, own] @ g.qp[own])

    def _linear(self, first: list[Real]) -> float:
        """Bound ``T_zw w + T_zp Phi T_qw w`` over the corners."""
        g, missed = self.gains, self.gains.tail
        for h, own in zip(self.half, self.owned, strict=True):
            zp, qw = g.zp[:, own], g.qw[own]
            missed += h * float(np.linalg.norm(g.tail * (qw.sum() + zp.sum(axis=1)) + RESPONSE_ROUNDING * (zp @ qw)))
        centre = np.zeros_like(first[0])
        centre[: g.terms] = g.zw
        parts = [h * z for h, z in zip(self.half, first, strict=True)]
        largest = np.argsort([-np.linalg.norm(z) for z in parts])
        most = _CORNERS if len(self.c.Cz) <= 1 else _CORNERS_OF_MANY
        added = sum(_peak(parts[i]) for i in largest[most:])
        return _largest_corner(centre, [parts[i] for i in largest[:most]]) + added + missed

    def _second(self, seen: list[Real]) -> Matrix:
        """Return the norms of all products of two parameters, at their half widths; symmetric."""
        out = np.zeros((len(seen), len(seen)))
        for i in range(len(seen)):
            for j in range(i + 1):
                size = sum(np.linalg.norm(H, axis=(1, 2)).sum() for H in self._of_two(i, j))
                missed = self._missed_of_two(i, seen[j]) + (self._missed_of_two(j, seen[i]) if i != j else 0.0)
                out[i, j] = out[j, i] = self.half[i] * self.half[j] * (size + missed)
        return out

    def _of_two(self, i: int, j: int) -> Iterator[Real]:
        """Yield the response of ``z`` to what two parameters do one after the other, in both orders."""
        c, zero = self.c, np.zeros_like(self.c.A)
        (Li, Di), (Lj, Dj) = ((self.loops[k], self.directs[k]) for k in (i, j))
        if i == j:
            A, C = np.block([[c.A, zero, zero], [Li, c.A, zero], [zero, Li, c.A]]), np.hstack([0 * Di, Di, c.Cz])
        else:
            A = np.block([[c.A, zero, zero, zero], [Li, c.A, zero, zero], [Lj, zero, c.A, zero], [zero, Lj, Li, c.A]])
            C = np.hstack([0 * Di, Dj, Di, c.Cz])
        B = np.zeros((len(A), c.Bw.shape[1]))
        B[: len(c.Bw)] = c.Bw
        return (H for H, _ in response_blocks(A, B, C, 3 * self.gains.terms))

    def _missed_of_two(self, i: int, norms: Real) -> float:
        """Bound what is cut off and rounded in the response of ``z`` to a parameter that sees ``q`` of first order."""
        g, own = self.gains, self.owned[i]
        # either the last factor is cut off, or one of those that made q
        made = norms[own].sum() + g.zp[:, own].sum(axis=1) * (g.qw.sum() + g.qp[own].sum())
        return float(np.linalg.norm(g.tail * made + RESPONSE_ROUNDING * (g.zp[:, own] @ (g.qp[own] @ g.qw))))

    def _weights(self, around: Matrix) -> Real:
        """Return about how much each parameter is to blame for gains that are too large."""
        right = left = np.ones(len(around))
        for _ in range(20):
            right, left = around @ right + 1e-3 * right, around.T @ left + 1e-3 * left
            right, left = right / right.max(), left / left.max()
        blame = np.zeros(self.count)
        for i, own in zip(self.moving, self.owned, strict=True):
            blame[i] = (right * left)[own].sum()
        return blame


def _solved(gains: Matrix, once: Real) -> Real | None:
    """Return ``x >= once + gains x``, or None without one."""
    if not len(once):
        return once
    x = np.linalg.solve(np.eye(len(gains)) - gains, np.column_stack([once, np.ones(len(once))]))
    # a positive x with x > G x proves that the powers of G die out
    if not ((x[:, 1] > 0).all() and (x[:, 1] - gains @ x[:, 1] > 0.5).all()):
        return None
    x = np.maximum(x[:, 0], 0.0) + 1e-9 * np.max(np.abs(x[:, 0]), initial=0.0) * x[:, 1]
    return x if np.all(x >= once + gains @ x) else None


def _peak(H: Real) -> float:
    """Return the largest sum of lengths of the responses along a direction of the outputs."""
    if H.shape[1] <= 1:
        return float(np.linalg.norm(H, axis=2).sum())
    return largest_sum(H, rtol=1e-3).upper


def _largest_corner(centre: Real, parts: list[Real]) -> float:
    """Return the largest peak norm of ``centre`` plus or minus each of the parts: of a convex function over a box."""
    signs = 1.0 - 2.0 * ((np.arange(2 ** len(parts))[:, None] >> np.arange(len(parts))) & 1)
    flat = np.array(parts).reshape(len(parts), centre.size)
    step, largest = max(1, _CHUNK // max(centre.size, 1)), 0.0
    for start in range(0, len(signs), step):
        H = (signs[start : start + step] @ flat).reshape(-1, *centre.shape) + centre
        if centre.shape[1] <= 1:
            largest = max(largest, float(np.linalg.norm(H, axis=3).sum(axis=(1, 2)).max()))
        else:
            largest = max(largest, *(_peak(one) for one in H))
    return largest
