"""The Jacobian of a user's function, with its error, and the places where the function has none."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import AccuracyError, ModelError
from residua.tolerances import IDENTITY, RESIDUE, TINY
from residua.visible import echo
from residua.words import number, some

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Function = Callable[[Vector], ArrayLike]

_EPS = float(np.finfo(float).eps)
#: Steps of the differences: the size of a variable times 2^-3 .. 2^-22.
_POWERS = np.arange(3, 23)
#: Columns of the extrapolation table: errors of the orders h^2, h^4, h^6 and h^8 are taken away.
_ORDERS = 4
#: The step of a first look, relative to the size of a variable: about the cube root of rounding.
_ROUGH = 2.0**-17
#: The step of the complex derivative, relative to the size of a variable: its square is far below rounding.
_IMAGINARY = 2.0**-70
#: A variable whose own value contributes less than this to every row is stepped by what has an effect as well.
_NEGLIGIBLE = 2.0**-10
#: One-sided slopes of a smooth function come 64 times nearer over the last six halvings, at a kink not at all.
_KINK, _KINK_STEPS = 0.25, 6
#: Slopes to both sides that differ by less are one slope that does not settle as steps shrink: a jump.
_SAME_SIDES = 0.01
#: How many times the rounding of a difference a disagreement must be, to be one.
_CLEAR = 100.0
#: Largest estimated error of an entry that is accepted, relative to the terms of its row.
_ACCEPTED = 2.0**-10


@dataclass(frozen=True, eq=False)
class Jacobian:
    """The derivative of a function at a point.

    Attributes
    ----------
    matrix : ndarray, shape (rows, columns)
    error : ndarray, shape (rows, columns)
        Estimated absolute error: by differences, that of the extrapolation and of rounding; by complex step, how far
        the differences are from it.
    sizes : ndarray, shape (columns,)
        The size of each variable, which its steps are fractions of.
    terms : ndarray, shape (rows,)
        The sum of the sizes of what each row is made of.
    complex_step : bool
        True for the derivative of a complex step, exact but for rounding.
    notes : tuple of str
    """

    matrix: Matrix
    error: Matrix
    sizes: Vector
    terms: Vector
    complex_step: bool
    notes: tuple[str, ...]

    @property
    def relative_error(self) -> float:
        """The largest estimated error of an entry, relative to the terms of its row."""
        return float((self.error * self.sizes / np.maximum(self.terms, TINY)[:, None]).max(initial=0.0))


def jacobian(
    function: Function,
    point: ArrayLike,
    rows: tuple[str, ...],
    columns: tuple[str, ...],
    sizes: Mapping[str, float] | None = None,
) -> Jacobian:
    r"""Return the derivative of a function at a point, with its estimated error.

    Central differences with steps that are halved twenty times, extrapolated (Romberg): the entry of the table with
    the smallest estimated error is taken, for each entry of the Jacobian. Where the function takes complex numbers,
    :math:`\mathrm{Im} f(z + i h e_j) / h` has no cancellation, and is taken where it agrees with the differences.

    Steps are fractions of the size of a variable: of its value, or, where that is zero or without effect, of the change
    that moves the function as much as the others do. So nothing depends on units.

    Parameters
    ----------
    function : callable
        From a vector to a vector with one entry for each row.
    point : array_like, shape (columns,)
    rows, columns : tuple of str
        Names for messages.
    sizes : mapping of str to float, optional
        Column to the size of its variable, where its value does not tell.

    Returns
    -------
    Jacobian

    Raises
    ------
    ModelError
        If the function is not smooth at the point (one-sided slopes disagree), or gives no finite numbers.
    AccuracyError
        If the estimated error of an entry is above 1e-3 of the terms of its row.

    References
    ----------
    Ridders (1982), Advances in Engineering Software 4(2); Squire and Trapp (1998), SIAM Review 40(1).
    """
    z = np.array(point, dtype=float)
    f = checked(function, rows)
    look = first_look(f, z, columns, sizes)
    size, wrong = look.sizes, []
    matrix, error = np.zeros((len(rows), len(z))), np.zeros((len(rows), len(z)))
    for j in range(len(z)):
        matrix[:, j], error[:, j], kinks = _extrapolated(f, z, j, look, rows, columns)
        wrong += kinks
    if wrong:
        raise ModelError(
            f"no linear model exists at this point: {some(wrong, 4)}. Such places come from abs, sign, limits or the "
            "root of zero (or from a function with numerical noise): linearise at a point beside it, or use a "
            "smooth form"
        )
    terms = np.maximum(look.terms, (np.abs(matrix) * size).sum(axis=1))
    exact, why = False, "its complex derivative is another one (abs, sign or real parts do that)"
    by_complex = np.zeros(matrix.shape)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("error", np.exceptions.ComplexWarning)
            for j, step in enumerate(_IMAGINARY * size):
                moved = z + 1j * step * (np.arange(len(z)) == j)
                values = np.asarray(function(moved))  # pyright: ignore[reportArgumentType]
                by_complex[:, j] = np.imag(np.atleast_1d(values)) / step
        off = np.abs(by_complex - matrix)
        allowed = _CLEAR * error + IDENTITY * terms[:, None] / size
        exact = bool(np.isfinite(by_complex).all() and np.all(off <= allowed))
        matrix, error = (by_complex, off) if exact else (matrix, error)
    except Exception as problem:  # whatever a user's function raises when it meets a complex number
        why = f"it takes no complex numbers ({type(problem).__name__})"
    relative = error * size / np.maximum(terms, TINY)[:, None]
    if relative.max(initial=0.0) > _ACCEPTED:
        i, j = np.unravel_index(int(relative.argmax()), relative.shape)
        raise AccuracyError(
            f"the slope of {rows[i]} over {columns[j]} is {number(matrix[i, j])} with an estimated error of "
            f"{number(error[i, j], 2)}, {number(relative[i, j], 2)} of the terms of its row (limit {_ACCEPTED:g}): the "
            f"function is noisy or nearly not smooth there; give sizes={{{columns[j]!r}: ...}}, its usual change"
        )
    nothing = np.abs(matrix) * size <= RESIDUE * terms[:, None]
    matrix = np.where(nothing if exact else nothing | (np.abs(matrix) <= error), 0.0, matrix)
    notes = look.notes if exact else (*look.notes, f"the derivative is by differences: {why}")
    return Jacobian(matrix, error, size, terms, exact, notes)


def checked(function: Function, rows: tuple[str, ...]) -> Callable[[Vector], Vector]:
    """Return the function with its answers as vectors of floats, never of another shape, perhaps not finite."""

    def values(z: Vector) -> Vector:
        with np.errstate(all="ignore"):
            out = np.asarray(function(z.copy()))
        if np.iscomplexobj(out):
            raise ModelError("the function gives complex numbers for real ones: a model has real rates and outputs")
        try:
            out = np.atleast_1d(out.astype(float))
        except (TypeError, ValueError) as error:
            raise ModelError(f"the function must give numbers, got {echo(out)}") from error
        if out.shape != (len(rows),):
            raise ModelError(f"the function must give {len(rows)} numbers ({some(rows)}), got shape {out.shape}")
        return out

    return values


@dataclass(frozen=True, eq=False)
class FirstLook:
    """Values, slopes to some five digits, and the sizes that variables and rows have.

    Attributes
    ----------
    value, terms : ndarray, shape (rows,)
    slopes : ndarray, shape (rows, columns)
    sizes : ndarray, shape (columns,)
    notes : tuple of str
    """

    value: Vector
    terms: Vector
    slopes: Matrix
    sizes: Vector
    notes: tuple[str, ...]


def first_look(
    f: Callable[[Vector], Vector], z: Vector, columns: tuple[str, ...], sizes: Mapping[str, float] | None = None
) -> FirstLook:
    """Return rough slopes of a function near a point, and the sizes of its variables, by two evaluations for each."""
    value = f(z)
    if not np.isfinite(value).all():
        raise ModelError(f"the function gives {echo(value.tolist())} at {echo(z.tolist())}: no finite numbers")
    given = np.zeros(len(columns))
    for name, size in (sizes or {}).items():
        if name not in columns:
            raise ModelError(f"sizes: {echo(name)} is no variable; known: {some(columns)}")
        if not (isinstance(size, (int, float, np.number)) and np.isfinite(size) and size > 0):
            raise ModelError(f"sizes[{name!r}] must be a positive number, got {echo(size)}")
        given[columns.index(name)] = float(size)
    slopes = np.zeros((len(value), len(z)))
    known = np.where(given > 0, given, np.abs(z))
    for j in np.flatnonzero(known):
        slopes[:, j] = _rough_slope(f, z, value, int(j), known[j])
    terms = np.maximum((np.abs(slopes) * known).sum(axis=1), np.abs(value))
    sizeless = []
    for j in np.flatnonzero((given == 0) & (np.abs(slopes) * known <= _NEGLIGIBLE * terms[:, None]).all(axis=0)):
        effect = _size_of_effect(f, z, int(j), terms)
        if not effect and not known[j]:
            sizeless.append(columns[j])
        known[j] = effect or known[j] or 1.0
        slopes[:, j] = _rough_slope(f, z, value, int(j), known[j])
    notes = (f"no size is known of {some(sizeless)}: steps are fractions of 1; sizes={{name: size}} tells it",)
    return FirstLook(value, terms, slopes, known, notes if sizeless else ())


def _moved(z: Vector, j: int, step: float) -> Vector:
    out = z.copy()
    out[j] += step
    return out


def _rough_slope(f: Callable[[Vector], Vector], z: Vector, value: Vector, j: int, size: float) -> Vector:
    """Return one column by central differences; by one side where the other is outside of the function's range."""
    step = _ROUGH * size
    ahead, behind = f(_moved(z, j, step)), f(_moved(z, j, -step))
    out = (ahead - behind) / (2 * step)
    out = np.where(np.isfinite(out), out, (ahead - value) / step)
    out = np.where(np.isfinite(out), out, (value - behind) / step)
    return np.where(np.isfinite(out), out, 0.0)


def _size_of_effect(f: Callable[[Vector], Vector], z: Vector, j: int, terms: Vector) -> float:
    """Return the change of a variable, a power of two, that moves some row by about its terms; 0 where none does."""
    if not terms.any():
        return 0.0
    size = 1.0
    for _ in range(12):
        change = np.abs(f(_moved(z, j, size)) - f(_moved(z, j, -size))) / 2
        share = float((change / np.where(terms > 0, terms, np.inf)).max(initial=0.0))
        if not np.isfinite(share):
            size *= 2.0**-8
            continue
        power = 16.0 if share == 0 else round(-np.log2(share))
        size *= 2.0 ** min(max(power, -200), 200)
        if power == 0:
            break
    return size if share > 0 or not np.isfinite(share) else 0.0


def _extrapolated(
    f: Callable[[Vector], Vector], z: Vector, j: int, look: FirstLook, rows: tuple[str, ...], columns: tuple[str, ...]
) -> tuple[Vector, Vector, list[str]]:
    """Extrapolate central differences to a step of zero, and compare the slopes to both sides.

    Returns
    -------
    slope, error : ndarray, shape (rows,)
        The entries of the extrapolation table (Romberg's) with the least estimated error.
    kinks : list of str
        The rows whose one-sided slopes disagree, in words.
    """
    value, steps = look.value, look.sizes[j] * 2.0**-_POWERS
    up, down = (np.array([f(_moved(z, j, sign * h)) for h in steps]) for sign in (1, -1))
    # what was added is a little different from the step
    width_up, width_down = (z[j] + steps) - z[j], z[j] - (z[j] - steps)
    with np.errstate(all="ignore"):
        ahead, behind = (up - value) / width_up[:, None], (value - down) / width_down[:, None]
        table = (up - down) / (width_up + width_down)[:, None]
        every = np.abs(np.vstack([up, down, value]))
        most = np.maximum(np.where(np.isfinite(every), every, 0.0).max(axis=0), look.terms)
        noise, every_row = _EPS * most / steps[:, None], np.arange(len(value))
        slope, error = table[-1].copy(), np.full(len(value), np.inf)
        for order in range(1, _ORDERS + 1):
            better = (4.0**order * table[1:] - table[:-1]) / (4.0**order - 1)
            estimate = np.maximum(np.abs(better - table[1:]), np.abs(better - table[:-1])) + noise[order:]
            estimate = np.where(np.isfinite(estimate), estimate, np.inf)
            least = estimate.argmin(axis=0)
            smallest = estimate[least, every_row]
            slope = np.where(smallest < error, better[least, every_row], slope)
            error, table = np.minimum(error, smallest), better
        spread = np.fmax(np.abs(ahead - slope), np.abs(behind - slope))
    name, at = columns[j], number(z[j])
    if not (np.isfinite(up[-1]).all() and np.isfinite(down[-1]).all()):
        return slope, error, [f"{name} = {at} is at the edge of where the function gives finite numbers"]
    kinks = []
    for i in np.flatnonzero((spread[-1] > _KINK * spread[-1 - _KINK_STEPS]) & (spread[-1] > _CLEAR * noise[-1])):
        left, right = behind[-1, i], ahead[-1, i]
        sides = f"{number(left)} to the left and {number(right)} to the right"
        if abs(right - left) <= _SAME_SIDES * max(abs(right), abs(left)):
            sides = f"{number(right)} over the smallest step and {number(slope[i])} over larger ones"
        kinks.append(f"the slope of {rows[i]} over {name} at {name} = {at} is {sides}")
    return slope, error, kinks
