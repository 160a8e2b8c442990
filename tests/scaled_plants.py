"""Small plants of whole numbers, of many kinds, and the same plants in other units."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import residua as rs

KINDS = ("dense", "sparse", "companion", "integrators", "stiff", "dead sensor", "two alike", "through", "real")


@dataclass(frozen=True, eq=False)
class Units:
    """Factors of the signals of a plant; states and outputs are multiplied by them, inputs divided."""

    states: NDArray[np.float64]
    outputs: NDArray[np.float64]
    controls: NDArray[np.float64]
    disturbances: NDArray[np.float64]
    faults: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Numbers:
    """The matrices of a plant with disturbances and faults, all of small whole numbers but for the kind ``real``."""

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    Bd: NDArray[np.float64]
    Bf: NDArray[np.float64]
    C: NDArray[np.float64]
    Dd: NDArray[np.float64]
    Df: NDArray[np.float64]
    dt: float

    def plant(self) -> rs.Plant:
        """Return the plant; columns that do nothing are left out."""
        plant = rs.Plant(self.A, self.B, self.C, dt=self.dt)
        for letter, role in (("d", "disturbances"), ("f", "faults")):
            B, D = getattr(self, "B" + letter), getattr(self, "D" + letter)
            alive = [i for i in range(B.shape[1]) if B[:, i].any() or D[:, i].any()]
            if alive:
                plant = getattr(plant, f"with_{role}")({f"{letter}{i}": (B[:, i], D[:, i]) for i in alive})
        return plant

    def units(self, rng: np.random.Generator, most: int = 20) -> Units:
        """Return powers of two from ``2^-most`` to ``2^most`` for each signal."""
        counts = (len(self.A), len(self.C), self.B.shape[1], self.Bd.shape[1], self.Bf.shape[1])
        return Units(*(2.0 ** rng.integers(-most, most + 1, count) for count in counts))

    def in_units(self, u: Units) -> Numbers:
        """Return the same plant in other units."""
        T, Y = u.states[:, None], u.outputs[:, None]
        return replace(
            self,
            A=T * self.A / u.states,
            B=T * self.B * u.controls,
            Bd=T * self.Bd * u.disturbances,
            Bf=T * self.Bf * u.faults,
            C=Y * self.C / u.states,
            Dd=Y * self.Dd * u.disturbances,
            Df=Y * self.Df * u.faults,
        )

    def in_other_units(self, seed: int) -> Numbers:
        """Return the same plant in units that a seed makes."""
        return self.in_units(self.units(np.random.default_rng(seed)))


def numbers(seed: int) -> Numbers:
    """Return the plant of a seed."""
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    n, p, m = int(rng.integers(1, 7)), int(rng.integers(1, 6)), int(rng.integers(1, 3))
    q, s = int(rng.integers(0, 3)), int(rng.integers(1, 4))
    density = 0.5 if kind == "sparse" else 1.0

    def whole(*shape: int) -> NDArray[np.float64]:
        if kind == "real":
            return rng.standard_normal(shape)
        return rng.integers(-3, 4, shape) * (rng.random(shape) < density) + 0.0

    A, C, Dd, Df = whole(n, n), whole(p, n), np.zeros((p, q)), np.zeros((p, s))
    if kind in ("companion", "integrators"):
        A = np.diag(np.ones(n - 1), 1)
        A[-1] = 0 if kind == "integrators" else rng.integers(-3, 4, n)
    if kind == "stiff":
        A *= 2.0 ** rng.integers(-8, 9, n)[:, None]
    if kind == "dead sensor":
        C[rng.integers(p)] = 0
    if kind == "two alike" and p > 1:
        C[1] = C[0]
    if kind == "through":
        Dd, Df = whole(p, q), whole(p, s)
    dt = 0.0 if kind == "integrators" else float(rng.choice([0.0, 0.125]))
    return Numbers(A / 4 if dt else A, whole(n, m), whole(n, q), whole(n, s), C, Dd, Df, dt)


def with_rates_times(plant: rs.Plant, factor: float) -> rs.Plant:
    """Return a continuous plant in another unit of time, in which its rates are so many times as large."""
    return plant._with(**{name: factor * getattr(plant, name) for name in ("A", "B", "Bd", "Bf", "Bw")})
