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
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua.errors import DesignError, ModelError
from residua.linear.norms.impulse_terms import StableSystem, impulse_blocks, response_blocks, stable_system
from residua.linear.norms.peak_direction import largest_sum
from residua.linear.norms.peak_norm import peak_norm
from residua.linear.norms.star_norm import ellipsoid_shape, star_ellipsoid
from residua.linear.poles.spectrum import spectral_radius
from residua.linear.systems.state_space import StateSpace
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
#: Inputs reach a state by way of so many parameters, one after the other.
_WIDENINGS = 3
#: What rounding of sums of responses may do to the bound.
_ROUNDED = 1 + 1e-9


@dataclass(frozen=True, eq=False)
class ReachedMiddle:
    """The middle of the set, and the reach of inputs of unit size in it, by way of parameters as well.

    Attributes
    ----------
    middle : StableSystem
        In balanced units of its states.
    Q : ndarray, shape (n, n)
        An ellipsoid about what is reached, in these.
    reach : ndarray, shape (channels,)
        How large ``q`` gets, about; 0 if nothing drives it.
    unit : float
        How large the output gets, about; 1 if nothing reaches it.
    rate : float
        Of the smallest ellipsoid, for the outputs, about what is reached.
    """

    middle: StableSystem
    Q: Matrix
    reach: NDArray[np.float64]
    unit: float
    rate: float


def reached_middle(system: UncertainSystem) -> ReachedMiddle:
    """Return units for an uncertain system.

    Where the middle of the set is not driven or not seen, other members may be: units come from all that inputs reach
    by way of parameters, else they would be units of rounding.
    """
    middle = system.member((system.low + system.high) / 2)
    both = StateSpace(middle.A, np.hstack([middle.B, system.Bp]), np.vstack([middle.C, system.Cq]), dt=system.dt)
    try:
        s = stable_system(both)
    except ModelError as error:
        raise DesignError(f"the middle of the set has no peak norm: {error}") from error
    s = replace(s, B=s.B[:, : middle.n_inputs], C=s.C[: middle.n_outputs], D=middle.D)
    half = (system.high - system.low)[list(system.channels)] / 2
    B, C, direct = half * system.Bp / s.units[:, None], system.Cq * s.units, half * system.Dzp
    # not the rate that is best for the outputs: what these do not see would grow without end
    rate = 0.5 * (1 - s.radius**2)
    Q, reach, wider = np.zeros_like(s.A), np.zeros(len(half)), s
    for _ in range(_WIDENINGS + 1):
        shape = ellipsoid_shape(s.A, wider.B, rate)
        if shape is None or not np.isfinite(shape).all():
            break
        Q = shape
        reach = np.sqrt(np.maximum(np.sum((C @ Q) * C, axis=1), 0.0))
        wider = replace(s, B=np.hstack([s.B, B * reach]), D=np.hstack([s.D, direct * reach]))
    star = star_ellipsoid(wider)
    return ReachedMiddle(s, Q, reach, float(star.bound) or 1.0, star.rate)


@dataclass(frozen=True, eq=False)
class CentredBound:
    """A bound of the output of all members, and its parts.

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
    e = _Expansion(system)
    return None if e.tail > _LARGEST_TAIL else e.bound()


class _Expansion:
    """The terms of the expansion: responses of chains of the centre, each driving the next by way of a parameter.

    All in even units: of states, of what the parameters see, and of the outputs. ``zw`` is the response itself, shape
    (terms, outputs, inputs); ``zp`` and ``qp`` are sums of absolute values, ``qw`` sums of lengths. No sum over what is
    cut off is larger than ``tail``, of any entry; it is in the others already.
    """

    def __init__(self, system: UncertainSystem) -> None:
        reached = reached_middle(system)
        s, self.unit = reached.middle, reached.unit
        unit = np.where(reached.reach > 0, reached.reach, 1.0)
        self.A, self.Bw, self.Bp = s.A, s.B, system.Bp / s.units[:, None] * unit
        self.Cz, self.Cq = s.C / reached.unit, system.Cq * s.units / unit[:, None]
        self.Dzw, self.Dzp = s.D / reached.unit, system.Dzp * unit / reached.unit
        half = (system.high - system.low) / 2
        self.moving = [i for i in range(len(half)) if half[i] > 0 and i in system.channels]
        self.owned = [np.flatnonzero(np.array(system.channels) == i) for i in self.moving]
        self.half, self.count = half[self.moving], len(half)
        self.width = half[list(system.channels)]
        self.loops = [self.Bp[:, channels] @ self.Cq[channels] for channels in self.owned]
        self.directs = [self.Dzp[:, channels] @ self.Cq[channels] for channels in self.owned]
        (p, m), k = self.Dzw.shape, len(self.Cq)
        D = np.block([[self.Dzw, self.Dzp], [np.zeros((k, m + k))]])
        both = StableSystem(
            s.A, np.hstack([self.Bw, self.Bp]), np.vstack([self.Cz, self.Cq]), D, np.ones(len(s.A)), s.radius
        )
        zw, self.zp, self.qp, self.qw, self.tail = [], np.zeros((p, k)), np.zeros((k, k)), np.zeros(k), np.inf
        for H, self.tail in impulse_blocks(both, most=min(_TERMS, _STORED // max(p * m * (2 + 2 * k), 1))):
            zw.append(H[:, :p, :m])
            self.zp += np.abs(H[:, :p, m:]).sum(axis=0)
            self.qp += np.abs(H[:, p:, m:]).sum(axis=0)
            self.qw += np.linalg.norm(H[:, p:, :m], axis=2).sum(axis=0)
            if self.tail <= _TAIL:
                break
        self.zw, self.terms = np.concatenate(zw), sum(map(len, zw))
        self.zp, self.qp, self.qw = self.zp + self.tail, self.qp + self.tail, self.qw + self.tail

    def bound(self) -> CentredBound:
        """Return the bound; its parts are infinite where small gains prove nothing."""
        around = self.qp * self.width
        gain, blame = float(spectral_radius(around)), np.zeros(self.count)
        for i, channels in zip(self.moving, self.owned, strict=True):
            blame[i] = (around.sum(axis=0) + around.sum(axis=1))[channels].sum()
        none = CentredBound(np.inf, np.inf, np.inf, blame, gain)
        if not gain < 1:
            return none
        first = [self._first(i) for i in range(len(self.moving))]
        seen = [norms for _, norms in first]
        away = _solved(around, sum((h * q for h, q in zip(self.half, seen, strict=True)), np.zeros(len(self.width))))
        if away is None:
            return none
        linear, second = self._linear([z for z, _ in first]), self._second(seen)
        front = sum((h * self._front(i) for i, h in enumerate(self.half)), np.zeros_like(self.zp))
        rest, blame = front * self.width * away, np.zeros(self.count)
        for i, channels, row in zip(self.moving, self.owned, second, strict=True):
            blame[i] = np.linalg.norm(rest[:, channels], axis=0).sum() + row.sum()
        both, last = float(np.triu(second).sum()), float(np.linalg.norm(rest.sum(axis=1)))
        return CentredBound(float(self.unit * linear), float(self.unit * both), float(self.unit * last), blame, gain)

    def _first(self, i: int) -> tuple[Real, Real]:
        """Return the response of ``z`` to a parameter, to first order, and the norms of that of ``q``."""
        channels, p = self.owned[i], len(self.Cz)
        zero = np.zeros_like(self.A)
        A = np.block([[self.A, zero], [self.loops[i], self.A]])
        C = np.block([[self.directs[i], self.Cz], [np.zeros_like(self.Cq), self.Cq]])
        z, q = [np.zeros((1, *self.Dzw.shape))], np.zeros(len(self.Cq))
        for H, _ in response_blocks(A, np.vstack([self.Bw, np.zeros_like(self.Bw)]), C, 2 * self.terms):
            z.append(H[:, :p])
            q += np.linalg.norm(H[:, p:], axis=2).sum(axis=0)
        missed = self.tail * (self.qw[channels].sum() + self.qp[:, channels].sum(axis=1)) + RESPONSE_ROUNDING * (
            self.qp[:, channels] @ self.qw[channels]
        )
        return np.concatenate(z), q + missed

    def _front(self, i: int) -> Matrix:
        """Return the norms of ``T_zp Phi T_qp`` for one parameter, shape (outputs, channels)."""
        channels = self.owned[i]
        A = np.block([[self.A, np.zeros_like(self.A)], [self.loops[i], self.A]])
        norms = np.zeros_like(self.zp)
        C = np.hstack([self.directs[i], self.Cz])
        for H, _ in response_blocks(A, np.vstack([self.Bp, np.zeros_like(self.Bp)]), C, 2 * self.terms):
            norms += np.abs(H).sum(axis=0)
        tail = self.tail * (self.zp[:, channels].sum(axis=1)[:, None] + self.qp[channels].sum(axis=0))
        return norms + tail + RESPONSE_ROUNDING * (self.zp[:, channels] @ self.qp[channels])

    def _linear(self, first: list[Real]) -> float:
        """Bound ``T_zw w + T_zp Phi T_qw w`` over the corners."""
        missed = self.tail
        for h, channels in zip(self.half, self.owned, strict=True):
            zp, qw = self.zp[:, channels], self.qw[channels]
            missed += h * float(np.linalg.norm(self.tail * (qw.sum() + zp.sum(axis=1)) + RESPONSE_ROUNDING * (zp @ qw)))
        centre = np.zeros_like(first[0])
        centre[: self.terms] = self.zw
        parts = [h * z for h, z in zip(self.half, first, strict=True)]
        largest = np.argsort([-np.linalg.norm(z) for z in parts])
        most = _CORNERS if len(self.Cz) <= 1 else _CORNERS_OF_MANY
        added = sum(_peak(parts[i]) for i in largest[most:])
        # convex, so that it is largest at a corner: the centre plus or minus each of the parts
        visited = [parts[i] for i in largest[:most]]
        signs = 1.0 - 2.0 * ((np.arange(2 ** len(visited))[:, None] >> np.arange(len(visited))) & 1)
        flat, reached = np.array(visited).reshape(len(visited), centre.size), 0.0
        step = max(1, _CHUNK // max(centre.size, 1))
        for start in range(0, len(signs), step):
            H = (signs[start : start + step] @ flat).reshape(-1, *centre.shape) + centre
            if centre.shape[1] <= 1:
                reached = max(reached, float(np.linalg.norm(H, axis=3).sum(axis=(1, 2)).max()))
            else:
                reached = max(reached, *(_peak(one) for one in H))
        return reached + added + missed

    def _second(self, norms: list[Real]) -> Matrix:
        """Return the norms of all products of two parameters, at their half widths; symmetric."""
        out = np.zeros((len(norms), len(norms)))
        for i in range(len(norms)):
            for j in range(i + 1):
                size = sum(np.linalg.norm(H, axis=(1, 2)).sum() for H in self._of_two(i, j))
                missed = self._missed_of_two(i, norms[j]) + (self._missed_of_two(j, norms[i]) if i != j else 0.0)
                out[i, j] = out[j, i] = self.half[i] * self.half[j] * (size + missed)
        return out

    def _of_two(self, i: int, j: int) -> Iterator[Real]:
        """Yield the response of ``z`` to what two parameters do one after the other, in both orders."""
        A0, zero = self.A, np.zeros_like(self.A)
        (Li, Di), (Lj, Dj) = ((self.loops[k], self.directs[k]) for k in (i, j))
        if i == j:
            A, C = np.block([[A0, zero, zero], [Li, A0, zero], [zero, Li, A0]]), np.hstack([0 * Di, Di, self.Cz])
        else:
            A = np.block([[A0, zero, zero, zero], [Li, A0, zero, zero], [Lj, zero, A0, zero], [zero, Lj, Li, A0]])
            C = np.hstack([0 * Di, Dj, Di, self.Cz])
        B = np.zeros((len(A), self.Bw.shape[1]))
        B[: len(self.Bw)] = self.Bw
        return (H for H, _ in response_blocks(A, B, C, 3 * self.terms))

    def _missed_of_two(self, i: int, norms: Real) -> float:
        """Bound the tail and the rounding of the response of ``z`` to a parameter that reads ``q`` of first order."""
        channels = self.owned[i]
        # either the last factor is cut off, or one of those that made q
        factors = norms[channels].sum() + self.zp[:, channels].sum(axis=1) * (self.qw.sum() + self.qp[channels].sum())
        rounding = RESPONSE_ROUNDING * (self.zp[:, channels] @ (self.qp[channels] @ self.qw))
        return float(np.linalg.norm(self.tail * factors + rounding))


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
