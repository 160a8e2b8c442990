"""Bases of polynomials that suit a set of poles: powers lose their digits where poles crowd together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False)
class PolynomialBasis:
    r"""Newton's basis on given nodes: :math:`N_0 = 1`, :math:`\rho_j N_{j+1} = (z - a_j) N_j + \beta_j N_{j-1}`.

    Every product of the first nodes is an element; a conjugate pair of nodes ``a +- bi`` takes two steps, of which the
    second has :math:`\beta = b^2 / \rho`. With all nodes zero and ``rho`` one these are the powers of ``z``.

    Attributes
    ----------
    real, imaginary : ndarray, shape (count,)
        Real parts of the nodes, and the imaginary part at the first of each pair, else zero.
    sizes : ndarray, shape (count,)
        ``rho``.
    """

    real: NDArray[np.float64]
    imaginary: NDArray[np.float64]
    sizes: NDArray[np.float64]

    @classmethod
    def powers(cls, count: int, size: float = 1.0) -> PolynomialBasis:
        """Return the powers of ``z / size``."""
        return cls(np.zeros(count), np.zeros(count), np.full(count, float(size)))

    @classmethod
    def on(cls, nodes: ArrayLike, *, in_order: bool = False) -> PolynomialBasis:
        """Return the basis on some nodes, closed under conjugation.

        In the order of Leja, each node as far as possible from those before it, with sizes that keep the elements near
        one on all nodes; or in the order given (pairs side by side) with sizes one.
        """
        values = np.asarray(nodes, dtype=np.complex128).ravel()
        if in_order:
            first = np.concatenate([np.zeros(0, dtype=bool), values.imag > 0])
            return cls(values.real.copy(), np.where(first, values.imag, 0.0), np.ones(len(values)))
        return cls(*_leja(values))

    @property
    def count(self) -> int:
        """The number of nodes, which is the highest degree."""
        return len(self.real)

    @property
    def links(self) -> NDArray[np.float64]:
        """``beta``, shape (count,): what couples the second of each pair to the element before the first."""
        out = np.zeros(self.count)
        for j in np.flatnonzero(self.imaginary):
            out[j + 1] = self.imaginary[j] ** 2 / self.sizes[j]
        return out

    def pairs_kept(self, degree: int) -> bool:
        """Tell whether the element of a degree is a product of whole pairs."""
        return degree == 0 or not self.imaginary[degree - 1]

    def values(self, points: ArrayLike, degree: int) -> NDArray[np.complex128]:
        """Return the elements up to a degree at some points, shape (points, degree + 1)."""
        z = np.asarray(points, dtype=np.complex128).ravel()
        out = np.ones((len(z), degree + 1), dtype=np.complex128)
        links = self.links
        for j in range(degree):
            out[:, j + 1] = (z - self.real[j]) * out[:, j]
            if links[j]:
                out[:, j + 1] += links[j] * out[:, j - 1]
            out[:, j + 1] /= self.sizes[j]
        return out

    def times_variable(self, coefficients: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the coefficients of ``z x(z)``, along the first axis, which grows by one."""
        k = len(coefficients)
        if k > self.count:
            raise ValueError(f"a basis on {self.count} nodes holds no polynomial of degree {k}")
        out = np.zeros((k + 1, *coefficients.shape[1:]))
        shape = (-1, *(1,) * (coefficients.ndim - 1))
        out[1:] += self.sizes[:k].reshape(shape) * coefficients
        out[:-1] += self.real[:k].reshape(shape) * coefficients
        out[: k - 1] -= self.links[1:k].reshape(shape) * coefficients[1:]
        return out

    def elements_in(self, other: PolynomialBasis, degree: int) -> NDArray[np.float64]:
        """Return the elements up to a degree as combinations of those of another basis: lower triangular, by rows."""
        rows = np.zeros((degree + 1, degree + 1))
        rows[0, 0] = 1.0
        links = self.links
        for j in range(degree):
            row = other.times_variable(rows[j, : j + 1])
            row[: j + 1] -= self.real[j] * rows[j, : j + 1]
            if links[j]:
                row[:j] += links[j] * rows[j - 1, :j]
            rows[j + 1, : j + 2] = row / self.sizes[j]
        return rows

    def changed_to(self, other: PolynomialBasis, coefficients: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the coefficients in another basis of polynomials that are given in this one, along the first axis."""
        k = len(coefficients) - 1
        flat = coefficients.reshape(k + 1, -1)
        L = other.elements_in(self, k)  # the other's elements in this basis
        out = scipy.linalg.solve_triangular(L.T, flat, lower=False, check_finite=False)
        return np.asarray(out, dtype=float).reshape(coefficients.shape)


def _leja(values: NDArray[np.complex128]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return real parts, imaginary parts and sizes of nodes in the order of Leja."""
    upper = values[values.imag >= 0]
    rest = list(range(len(upper)))
    log_size = np.zeros(len(upper))  # of the current element at each node
    center = upper.mean().real if len(upper) else 0.0
    real, imaginary, sizes = [], [], []
    previous = 1.0
    while rest:
        far = np.abs(upper[rest] - center) if not real else log_size[rest]
        pick = rest.pop(int(np.argmax(far)))
        node = upper[pick]
        for step, conjugate in enumerate([node, node.conjugate()] if node.imag > 0 else [node]):
            with np.errstate(divide="ignore"):
                log_size = log_size + np.log(np.abs(upper - conjugate))
            left = log_size[rest] if rest else np.zeros(0)
            largest = float(np.max(left, initial=-np.inf))
            size = float(np.exp(largest)) if np.isfinite(largest) else previous
            log_size = log_size - np.log(size)
            previous = size
            real.append(node.real)
            imaginary.append(node.imag if step == 0 else 0.0)
            sizes.append(size)
    return np.array(real), np.array(imaginary), np.array(sizes)


def combined(bases: Sequence[PolynomialBasis]) -> PolynomialBasis:
    """Return a basis on the nodes of one after another."""
    return PolynomialBasis(
        np.concatenate([b.real for b in bases]),
        np.concatenate([b.imaginary for b in bases]),
        np.concatenate([b.sizes for b in bases]),
    )
