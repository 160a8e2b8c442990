"""The cost of many estimators at once, over chosen members of the uncertain set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.poles.spectrum import spectral_radius
from residua.plant import Plant
from residua.robust.estimators.estimator_family import EstimatorFamily

Matrix = NDArray[np.float64]
#: What is left of the impulse response where its sum is broken off.
_TAIL = 1e-4
#: Samples that are summed one by one; beyond, the step doubles every so many.
_DENSE, _PER_OCTAVE = 128, 64
#: What the time to settle counts, at the longest allowed: of gains that cost the same the fastest is taken.
_HASTE = 2e-3
_NO_RESPONSE = 1e-7
#: Cost of an estimator that is not stable, or too slow, or blind; its spectral radius is added. No other costs as much.
PENALTY = 1e6


@dataclass(frozen=True)
class Weights:
    r"""The weights of the cost (40), :math:`J = \beta J_{rw} + (1 - \beta) / J_{rf} + \gamma J_{rw} / J_{rf}`.

    The size of the residual is free, and the best one follows: scaled by :math:`s`, the first two terms are least at
    :math:`s^2 = (1 - \beta) / (\beta J_{rw} J_{rf})`. What is left, :math:`2 \sqrt{\beta (1 - \beta) q} + \gamma q`,
    depends on the ratio :math:`q = J_{rw} / J_{rf}` alone, and grows with it.
    """

    beta: float
    gamma: float

    def cost(self, disturbance: NDArray[np.float64], fault: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the cost with the best size of the residual; infinite where the fault is not seen."""
        ratio = np.full(np.shape(disturbance), np.inf)
        np.divide(disturbance, fault, out=ratio, where=fault > 0)
        both = self.beta * (1 - self.beta)
        # weights of zero are no terms: zero times infinity would be none either
        cost = 2 * np.sqrt(both * ratio) if both else np.zeros_like(ratio)
        return cost + self.gamma * ratio if self.gamma else cost

    def scale(self, disturbance: float, fault: float) -> float:
        """Return the best size of the residual; where none is best, that with a response of one to the fault."""
        if 0 < self.beta < 1 and disturbance > 0:
            return float(np.sqrt((1 - self.beta) / (self.beta * disturbance * fault)))
        return 1 / fault


@dataclass(frozen=True, eq=False)
class Norms:
    """Norms of many estimators, one entry each.

    Attributes
    ----------
    disturbance : ndarray
        ``J_rw``: of disturbances and bounded faults together, the largest over the members; NaN where not computed.
    alone : ndarray
        That of the disturbances alone.
    fault : ndarray
        ``J_rf``: the smallest response to the target.
    radius : ndarray
        Spectral radius.
    """

    disturbance: NDArray[np.float64]
    alone: NDArray[np.float64]
    fault: NDArray[np.float64]
    radius: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SampledCost:
    """The cost of many estimators of a family, over some members of the set.

    Attributes
    ----------
    family : EstimatorFamily
    weights : Weights
    disturbances : int
        How many of the first inputs are disturbances, which have one size together; every further one is a bounded
        fault.
    radius : float
        Largest spectral radius of an estimator that counts.
    frequencies : ndarray of complex
        ``exp(j omega dt)`` at which the response to the target counts.
    parts : tuple of _MemberParts
    unit : float
        What costs are divided by: they have the unit of the fault, and what is not stable costs more than any.
    """

    family: EstimatorFamily
    weights: Weights
    disturbances: int
    radius: float
    frequencies: NDArray[np.complex128]
    parts: tuple[_MemberParts, ...]
    unit: float = 1.0

    def __call__(self, points: Matrix) -> NDArray[np.float64]:
        """Return the cost of every point, shape (k,), in its unit and with a trifle for slowness."""
        return self.ranked(self.norms(points))

    def ranked(self, norms: Norms) -> NDArray[np.float64]:
        """Return the cost of estimators with known norms; any that is of use costs less than one that is not."""
        slowness = np.log(self.radius) / np.log(np.clip(norms.radius, 1e-6, 1 - 1e-12))
        cost = self.weights.cost(norms.disturbance, norms.fault) * (1 + _HASTE * slowness) / self.unit
        useful = np.isfinite(cost) & (norms.radius <= self.radius)
        return np.where(useful, np.minimum(cost, np.nextafter(PENALTY, 0)), PENALTY + norms.radius)

    def norms(self, points: Matrix) -> Norms:
        """Return the norms of every point."""
        Z, g = self.family.split(points)
        F = self.family.A - Z @ self.family.C
        radius = spectral_radius(F)
        values = np.full((3, len(Z)), np.nan)
        usable = radius <= self.radius
        if usable.any():
            gains = F[usable], Z[usable], g[usable]
            sums = np.array([self._member_norm(part, *gains) for part in self.parts])
            values[:, usable] = sums.sum(axis=2).max(axis=0), sums[:, :, 0].max(axis=0), self._fault(*gains)
        return Norms(values[0], values[1], values[2], radius)

    def _member_norm(self, part: _MemberParts, F: Matrix, Z: Matrix, g: Matrix) -> NDArray[np.float64]:
        """Return the sums of lengths of one member's impulse responses, shape (k, 1 + faults).

        Of the first samples every one is looked at, then every second, every fourth and so on.
        """
        n = len(part.A)
        A = np.zeros((len(F), n + F.shape[1], n + F.shape[1]))
        A[:, :n, :n], A[:, n:, n:] = part.A, F
        A[:, n:, :n] = part.driven - Z @ part.seen
        x = np.concatenate([np.broadcast_to(part.B, (len(F), *part.B.shape)), part.start - Z @ part.direct], axis=1)
        row = np.concatenate([g @ part.seen, g @ self.family.C], axis=1)[:, None]
        total = self._lengths(g[:, None] @ part.direct)[:, 0]
        before, power = self._lengths(row @ x), A
        # of the slowest that may come: what one costs must not depend on the others that are looked at with it
        slowest = min(max(self.radius, *(one.radius for one in self.parts), 0.1), 1 - 1e-9)
        terms = int(np.ceil(np.log(_TAIL) / np.log(slowest)))
        covered, stride, count = 0, 1, min(terms, _DENSE)
        while covered < terms:
            outputs, leap = row @ power, power  # row power^k for k = 1..count, by doubling
            while outputs.shape[1] < count:
                outputs, leap = np.concatenate([outputs, outputs @ leap], axis=1), leap @ leap
            now = self._lengths((outputs @ x)[:, :count])
            last = np.concatenate([before, now[:, :-1]], axis=1)
            # the samples between two that are looked at are taken to lie on a line
            total += (stride * (last + now) / 2 + (last - now) / 2).sum(axis=1)
            before, power, x = now[:, -1:], power @ power, leap @ x
            covered, stride, count = covered + stride * count, 2 * stride, _PER_OCTAVE
        return total + before[:, 0]

    def _lengths(self, h: Matrix) -> Matrix:
        """Return the lengths of terms of the impulse response to the disturbances, and to every fault."""
        n = self.disturbances
        return np.concatenate([np.linalg.norm(h[..., :n], axis=2, keepdims=True), np.abs(h[..., n:])], axis=2)

    def _fault(self, F: Matrix, Z: Matrix, g: Matrix) -> NDArray[np.float64]:
        """Return the smallest response to the target over frequencies and members."""
        smallest = np.full(len(F), np.inf)
        for k, z in enumerate(self.frequencies):
            z = z.real if abs(z.imag) < 1e-15 else z
            M = z * np.eye(F.shape[1]) - F
            for part in self.parts:
                v, start = part.faults[k]
                e = start - Z @ v
                inner = np.linalg.solve(M, e[..., None])[..., 0] if F.shape[1] else e
                filtered, direct = np.einsum("ki,ki->k", g, inner @ self.family.C.T), g @ v
                r = np.abs(filtered + direct)
                # what is rounding against the two terms that cancel is nothing
                r = np.where(r > _NO_RESPONSE * (np.abs(filtered) + np.abs(direct)), r, 0.0)
                smallest = np.minimum(smallest, r)
        return smallest


@dataclass(frozen=True, eq=False)
class _MemberParts:
    """The effect of one member of the set on the error of every estimator of a family.

    ``x' = A x + B w``, ``e' = F e + (driven - Z seen) x + (start - Z direct) w``, ``r = g (C e + seen x + direct w)``;
    ``seen`` and ``driven`` are what the member differs from the nominal loop by. ``faults`` holds for every frequency
    what the target brings to what is seen, and to the error.
    """

    A: Matrix
    B: Matrix
    seen: Matrix
    driven: Matrix
    start: Matrix
    direct: Matrix
    faults: list[tuple[NDArray, NDArray]]
    radius: float


def sampled_cost(
    family: EstimatorFamily,
    members: Sequence[Plant],
    weights: Weights,
    *,
    radius: float,
    band: float = 0.0,
    bounded: Mapping[str, float] | None = None,
) -> SampledCost:
    """Prepare the cost for some members of the set; faults in ``bounded`` count as disturbances of that size."""
    plant, bounded = family.plant, bounded or {}
    columns = [plant.faults.index(name) for name in bounded]
    sizes = np.array(list(bounded.values()))
    T, L, N = family.state_map, family.inject, family.read
    i = plant.faults.index(family.target)
    frequencies = np.exp(1j * np.linspace(0.0, band, 1 if band == 0 else 9) * plant.dt)
    parts = []
    for member in members:
        B = np.hstack([member.Bd, member.Bf[:, columns] * sizes])
        D = np.hstack([member.Dd, member.Df[:, columns] * sizes])
        b, d = member.Bf[:, i], member.Df[:, i]
        dA, dC = member.A - plant.A, member.C - plant.C
        seen, driven = N @ dC, T @ dA - L @ dC
        one, faults = np.eye(len(member.A)), []
        for z in frequencies:
            x = np.linalg.solve((z.real if abs(z.imag) < 1e-15 else z) * one - member.A, b)
            faults.append((seen @ x + N @ d, driven @ x + T @ b - L @ d))
        slowest = float(spectral_radius(member.A))
        parts.append(_MemberParts(member.A, B, seen, driven, T @ B - L @ D, N @ D, faults, slowest))
    return SampledCost(family, weights, len(plant.disturbances), radius, frequencies, tuple(parts))
