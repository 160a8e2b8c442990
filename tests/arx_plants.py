"""Generated equations with their own errors, and recordings of them, for the tests of their identification."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class TrueEquations:
    """``y_i[k] = sum_l a[l, i] y[k-l] + b[l, i] u[k-l] + e_i[k]``; rows 0 of both are zero."""

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    orders: tuple[int, ...]

    def recorded(
        self, rng: np.random.Generator, rows: int, ratio: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return inputs and outputs, white errors a part of what the inputs move the outputs."""
        u = rng.standard_normal((rows, self.b.shape[2]))
        size = self.simulated(u, np.zeros((rows, self.a.shape[1]))).std(axis=0)
        return u, self.simulated(u, size / ratio * rng.standard_normal((rows, len(size))))

    def simulated(self, u: NDArray[np.float64], e: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the outputs from rest."""
        last, p = len(self.a) - 1, e.shape[1]
        pushed = e + sum(
            np.vstack([np.zeros((row, p)), u[: len(u) - row] @ self.b[row].T]) for row in range(1, last + 1)
        )
        weights = np.hstack(list(self.a[:0:-1]))  # the oldest row first
        y = np.zeros((len(e) + last, p))
        for k in range(len(e)):
            y[k + last] = pushed[k] + weights @ y[k : k + last].ravel()
        return y[last:]


def true_equations(rng: np.random.Generator, orders: tuple[int, ...], m: int) -> TrueEquations:
    """Return stable equations of their own pasts, with zeros that do not cancel poles."""
    p, most = len(orders), max(orders)
    a, b = np.zeros((most + 1, p, p)), np.zeros((most + 1, p, m))
    for i, order in enumerate(orders):
        roots: list[complex] = []
        while len(roots) < order:
            r, w = rng.uniform(0.5, 0.9), rng.uniform(0.3, 2.8)
            pair = order - len(roots) >= 2 and rng.random() < 0.6
            roots += [r * np.exp(1j * w), r * np.exp(-1j * w)] if pair else [rng.uniform(-0.85, 0.9) + 0j]
        a[1 : order + 1, i, i] = -np.poly(roots).real[1:]
        b[1 : order + 1, i] = rng.choice([-1, 1], (order, m)) * rng.uniform(0.5, 1.5, (order, m))
    return TrueEquations(a, b, orders)
