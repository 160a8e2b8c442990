"""Bases of polynomials that suit a set of poles: powers lose their digits where poles crowd together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False)
class PolynomialBasis:
    r"""Newton's basis on nodes: :math:`N_0 = 1`, :math:`\rho_j N_{j+1} = (z - a_j) N_j + \beta_j N_{j-1}`.

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
    def on(cls, nodes: ArrayLike, *, size: float = 1.0) -> PolynomialBasis:
        """Return the basis on some nodes, closed under conjugation, in the order of Leja.

        Each is as far as possible from those before it, with sizes that keep the elements near one on all nodes,
        ``size`` where all nodes meet.
        """
        values = np.asarray(nodes, dtype=np.complex128).ravel()
        upper = values[values.imag >= 0]
        rest = list(range(len(upper)))
        log_size = np.zeros(len(upper))  # of the current element at each node
        center = upper.mean().real if len(upper) else 0.0
        real, imaginary, sizes = [], [], []
        previous = size
        while rest:
            far = np.abs(upper[rest] - center) if not real else log_size[rest]
            pick = rest.pop(int(np.argmax(far)))
            node = upper[pick]
            for step, conjugate in enumerate([node, node.conjugate()] if node.imag > 0 else [node]):
                with np.errstate(divide="ignore"):
                    log_size = log_size + np.log(np.abs(upper - conjugate))
                left = log_size[rest] if rest else np.zeros(0)
                largest = float(np.max(left, initial=-np.inf))
                factor = float(np.exp(largest)) if np.isfinite(largest) else previous
                log_size = log_size - np.log(factor)
                previous = factor
                real.append(node.real)
                imaginary.append(node.imag if step == 0 else 0.0)
                sizes.append(factor)
        return cls(np.array(real), np.array(imaginary), np.array(sizes))

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
        """Return coefficients in this basis as coefficients in another one, along the first axis."""
        k = len(coefficients) - 1
        flat = coefficients.reshape(k + 1, -1)
        return (self.elements_in(other, k).T @ flat).reshape(coefficients.shape)


def basis_on_poles(poles: ArrayLike, count: int, size: float, *, outward: bool = False) -> PolynomialBasis:
    """Return a basis with some number of nodes, on poles, each used as often as needed.

    Parameters
    ----------
    poles : array_like of complex
        Closed under conjugation; those that are not finite are left out. Without any: powers of ``z / size``.
    count : int
        The number of nodes at least.
    size : float
        Of the elements when the poles do not tell it: all are one, or there is none.
    outward : bool
        Whether the order of Leja is reversed: nodes far out come last. A division by all nodes, from the highest
        element down, then meets the fast modes first, and nothing that it leaves grows; that keeps the digits of
        polynomials that use all of the nodes, when some are far out. Those of few nodes want the far ones first.
    """
    values = np.asarray(poles, dtype=np.complex128).ravel()
    values = values[np.isfinite(values)]
    values = np.where(np.abs(values.imag) < 1e-9 * np.abs(values), values.real, values)
    if not len(values):
        return PolynomialBasis.powers(count, size)
    if len(values) > 1 and np.all(values == values[0]):
        a = values[0].real
        return PolynomialBasis(np.full(count, a), np.zeros(count), np.full(count, float(size)))
    size = float(np.median(np.abs(values))) or size
    floor = 1e-4 * size  # poles that meet would make sizes of rounding
    one = PolynomialBasis.on(values, size=size)
    one = PolynomialBasis(one.real, one.imaginary, np.maximum(one.sizes, floor))
    if outward:  # pairs kept; the size of a step down to the node before is that of the node before
        order = np.arange(one.count)[::-1]
        for j in np.flatnonzero(one.imaginary):
            at = one.count - 1 - j
            order[[at - 1, at]] = order[[at, at - 1]]
        one = PolynomialBasis(one.real[order], one.imaginary[order], np.roll(one.sizes[::-1], -1))
    times = -(-count // one.count)
    return PolynomialBasis(*(np.tile(x, times) for x in (one.real, one.imaginary, one.sizes)))
