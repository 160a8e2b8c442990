"""Polynomials and equations of polynomials as one reads them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray


def polynomial_text(coefficients: NDArray[np.float64], variable: str, *, digits: int = 5) -> str:
    """Return a polynomial as text, highest power first.

    Parameters
    ----------
    coefficients : ndarray, shape (degree + 1,)
        Lowest power first.
    variable : str
    digits : int
        Significant digits of each coefficient.

    Returns
    -------
    str

    Examples
    --------
    >>> polynomial_text(np.array([0.2, -0.9, 1.0]), "z")
    'z^2 - 0.9 z + 0.2'
    """
    parts = [(float(value), _power(variable, k)) for k, value in reversed(list(enumerate(coefficients))) if value != 0]
    return _sum((value < 0, _monomial(abs(value), power, digits)) for value, power in parts)


def equation_text(
    left: Iterable[tuple[NDArray[np.float64], str]],
    right: Iterable[tuple[NDArray[np.float64], str]],
    variable: str,
    *,
    digits: int = 5,
) -> str:
    """Return an equation between sums of polynomials times signals; signals with a zero polynomial are left out."""
    return " = ".join(
        _sum(_term(p, signal, variable, digits) for p, signal in side if np.any(p)) for side in (left, right)
    )


def _term(p: NDArray[np.float64], signal: str, variable: str, digits: int) -> tuple[bool, str]:
    """Return the sign (true: minus) and the text of one polynomial times a signal."""
    used = np.flatnonzero(p)
    minus = bool(p[used[-1]] < 0)
    size = -p if minus else p
    name = f"[{signal}]" if any(c.isspace() for c in signal) else signal
    if len(used) > 1:
        return minus, f"({polynomial_text(size, variable, digits=digits)}) {name}"
    factor = _monomial(float(size[used[0]]), _power(variable, int(used[0])), digits)
    return minus, name if factor == "1" else f"{factor} {name}"


def _sum(terms: Iterable[tuple[bool, str]]) -> str:
    out = ""
    for minus, text in terms:
        sign = (" - " if minus else " + ") if out else ("-" if minus else "")
        out += sign + text
    return out or "0"


def _monomial(size: float, power: str, digits: int) -> str:
    number = f"{size:.{digits}g}"
    if not power:
        return number
    return power if number == "1" else f"{number} {power}"


def _power(variable: str, k: int) -> str:
    return "" if k == 0 else variable if k == 1 else f"{variable}^{k}"
