"""Recordings of generated sampled plants, for what is made from recordings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import residua as rs


@dataclass(frozen=True, eq=False)
class Recorded:
    """A stable sampled plant, and what it did with white inputs, starting at rest."""

    plant: rs.Plant
    u: NDArray[np.float64]
    y: NDArray[np.float64]

    @property
    def rows(self) -> NDArray[np.float64]:
        """Inputs, then outputs."""
        return np.hstack([self.u, self.y])

    @property
    def names(self) -> dict[str, tuple[str, ...]]:
        """The channels, as options."""
        return {"inputs": self.plant.inputs, "outputs": self.plant.outputs}


def diagnosed(monitor: rs.Monitor, rows: NDArray[np.float64]) -> rs.Diagnosis:
    """Return the diagnosis of one recording of all channels."""
    out = monitor.run(None, rows)
    assert isinstance(out, rs.Diagnosis)
    return out


def recorded(seed: int, noise: float, samples: int = 3000, *, outputs: int | None = None) -> Recorded:
    """Return a recording of a plant of 1 to 5 states; the noise is a part of the spread of each output."""
    rng = np.random.default_rng(seed)
    n, m, p = (int(rng.integers(low, high)) for low, high in ((1, 6), (1, 3), (1, 4)))
    p = outputs or p
    A = rng.standard_normal((n, n))
    A *= rng.uniform(0.3, 0.9) / np.abs(np.linalg.eigvals(A)).max()
    D = rng.standard_normal((p, m)) * (seed % 2)
    plant = rs.Plant(A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), D, dt=1.0)
    u = rng.standard_normal((samples, m))
    y = plant.system().simulate(u)
    return Recorded(plant, u, y + noise * y.std(axis=0) * rng.standard_normal(y.shape))
