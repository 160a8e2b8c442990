"""Where the roots of a rational polynomial lie: exactly, and how close to the boundary."""

from __future__ import annotations

from fractions import Fraction

from flint import ctx, fmpq, fmpq_poly


def is_stable(p: fmpq_poly, sampled: bool) -> bool:
    """Tell whether all roots have a negative real part, or lie inside the unit circle: by Routh's test, exactly."""
    n = p.degree()
    if n <= 0:
        return True
    if sampled:  # z = (1 + s) / (1 - s); a root at -1 lowers the degree
        up, down = fmpq_poly([1, 1]), fmpq_poly([1, -1])
        q = fmpq_poly([0])
        for k in range(n + 1):
            q = q + up**k * down ** (n - k) * p[k]
        if q.degree() < n:
            return False
        p = q
    coefficients = [Fraction(int(p[k].p), int(p[k].q)) for k in range(n, -1, -1)]
    if coefficients[0] < 0:
        coefficients = [-c for c in coefficients]
    first, second = coefficients[0::2], coefficients[1::2]
    while second:
        if first[0] <= 0 or second[0] <= 0:
            return False
        ratio = first[0] / second[0]
        padded = second + [Fraction(0)] * (len(first) - len(second))
        following = [a - ratio * b for a, b in zip(first[1:], padded[1:], strict=True)]
        first, second = second, following
    return first[0] > 0


def roots(p: fmpq_poly) -> list[tuple[complex, int]]:
    """Return the roots with their multiplicities, each right to the last digits of a float."""
    if p.degree() <= 0:
        return []
    before, ctx.prec = ctx.prec, 200
    try:
        return [(complex(z), int(k)) for z, k in p.numer().complex_roots()]
    finally:
        ctx.prec = before


def distance_to_boundary(p: fmpq_poly, sampled: bool) -> float:
    """Return how far the root nearest to the boundary of stability is from it, relative to its size, on it excluded.

    Roots on the boundary count as zero distance only where they are not there exactly.
    """
    nearest = float("inf")
    for z, _ in roots(p):
        d = abs(abs(z) - 1) if sampled else abs(z.real) / max(abs(z), 1e-300)
        if d > 1e-40:
            nearest = min(nearest, d)
    return nearest


def all_stable(p: fmpq_poly, sampled: bool) -> bool:
    """Tell the same from certified roots: the second opinion."""
    return all(abs(z) < 1 if sampled else z.real < 0 for z, _ in roots(p))


def half(x: int) -> fmpq:
    """Return a half of a whole number."""
    return fmpq(x, 2)
