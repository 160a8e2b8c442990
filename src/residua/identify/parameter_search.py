"""Parameters within bounds, the plants that they make, and the search for those that predict best."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError, ModelError, SettingError
from residua.identify.prediction_errors import (
    Errors,
    NonlinearModel,
    error_covariance,
    model_errors,
    plant_of,
    weights_of,
)
from residua.plant import Plant
from residua.progress import Progress
from residua.tolerances import RESPONSE_ROUNDING
from residua.visible import echo
from residua.words import number, some

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
#: The width of a parameter without bounds, as a multiple of its start.
_UNBOUNDED = 10.0
#: The step of a difference, relative to the parameter, or to this fraction of the distance of its bounds if larger.
_STEP, _LEAST_STEP = 2.0**-14, 2.0**-10
#: Estimate and weights take turns until the estimate moves by less than this part of a standard error.
_STANDS, _MOST_TURNS = 1e-2, 30
#: Points that are tried in a turn at most.
_MOST_TRIED = 50
#: The whole travel within the bounds counts as reached below this.
_AT_BOUND = 2.0**-20
#: Ratios of the points that fill a box evenly: the powers of one over the root of ``x^(d+1) = x + 1``.
_EVENLY = 2.0


class Parameter(NamedTuple):
    """A parameter: its bounds, where the search starts, and the unit of the search."""

    name: str
    low: float
    high: float
    start: float
    width: float


def parameters_of(parameters: Mapping[str, Sequence[float]]) -> tuple[tuple[Parameter, ...], bool]:
    """Return checked parameters, and True where a start was given for some."""
    if not isinstance(parameters, Mapping) or not parameters:
        raise SettingError("name at least one parameter: {name: (low, high)} or {name: (low, start, high)}")
    out, started = [], False
    for name, values in parameters.items():
        wanted = f"parameter {echo(name)}: give (low, high) or (low, start, high), in order, got {echo(values)}"
        try:
            v = [float(x) for x in values]
        except (TypeError, ValueError) as error:
            raise SettingError(wanted) from error
        if len(v) not in (2, 3) or np.isnan(v).any() or v != sorted(v) or not v[0] < v[-1]:
            raise SettingError(f"{wanted}; a constant is no parameter, it belongs into the function")
        if len(v) == 2 and not np.isfinite(v).all():
            raise SettingError(f"{wanted}: without bounds a start is needed")
        start = v[1] if len(v) == 3 else (v[0] + v[1]) / 2
        width = v[-1] - v[0] if np.isfinite([v[0], v[-1]]).all() else _UNBOUNDED * (abs(start) or 1.0)
        out.append(Parameter(str(name), v[0], v[-1], start, width))
        started |= len(v) == 3
    return tuple(out), started


class PlantAt:
    """The user's function from parameters to a plant, called by keywords or with a mapping, its answers checked."""

    def __init__(self, function: Callable[..., Plant | NonlinearModel], names: tuple[str, ...]) -> None:
        if not callable(function):
            raise ModelError(f"plant_at must be a function of the parameters, got {type(function).__name__}")
        self.function, self.names = function, names
        self.like: Plant | None = None
        self.by_keywords = True
        try:
            inspect.signature(function).bind(**dict.fromkeys(names))
        except TypeError:
            self.by_keywords = False
        except ValueError:  # not written in Python
            pass

    def __call__(self, values: Mapping[str, float]) -> Plant | NonlinearModel:
        """Return the model with these parameters."""
        given = {name: float(values[name]) for name in self.names}
        try:
            model = self.function(**given) if self.by_keywords else self.function(given)
        except Exception as error:  # whatever a user's function raises
            raised = f"raised {type(error).__name__}: {error}"
            if self.by_keywords:
                raise ModelError(f"{self.words(given)} {raised}") from error
            called = f"plant_at{inspect.signature(self.function)} was called with the mapping {{{self._text(given)}}}"
            raise ModelError(
                f"{called}, since it takes no keyword of these names, and {raised}; the parameters are "
                f"{some(self.names)}: it must take these as keywords, or one mapping of names to values"
            ) from error
        if not isinstance(model, (Plant, NonlinearModel)):
            raise ModelError(f"{self.words(given)} must return a Plant or NonlinearModel, got {type(model).__name__}")
        plant = plant_of(model)
        like = self.like or plant
        for what in ("inputs", "outputs", "dt"):
            if getattr(plant, what) != getattr(like, what):
                raise ModelError(
                    f"{self.words(given)} has the {what} {getattr(plant, what)}, "
                    f"other parameters give {getattr(like, what)}"
                )
        self.like = like
        return model

    def plant(self, values: Mapping[str, float]) -> Plant:
        """Return the linear plant with these parameters."""
        return plant_of(self(values))

    def words(self, values: Mapping[str, float]) -> str:
        """Return the call in words."""
        return f"plant_at({self._text(values, '=')})"

    def _text(self, values: Mapping[str, float], link: str = ": ") -> str:
        return ", ".join(f"{name}{link}{number(values[name], 8)}" for name in self.names)


@dataclass(frozen=True, eq=False)
class Task:
    """A fit of parameters of a plant to stretches of data.

    Attributes
    ----------
    plant_at : PlantAt
    parameters : tuple of Parameter
    data : list of ndarray, shape (time, inputs + outputs)
    dt : float
    offsets : tuple of int
        Columns with an unknown constant offset in each stretch.
    priors : ndarray, shape (2, parameters)
        Mean and standard deviation, in the units of the search; infinite without a prior.
    """

    plant_at: PlantAt
    parameters: tuple[Parameter, ...]
    data: list[Matrix]
    dt: float
    offsets: tuple[int, ...]
    priors: Matrix

    @property
    def widths(self) -> Vector:
        """The units of the search."""
        return np.array([p.width for p in self.parameters])

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        like = self.plant_at.like
        return like.n_outputs if like else 0

    def values(self, z: Vector) -> dict[str, float]:
        """Return the parameters at a point of the search, which is counted from the start."""
        return {
            p.name: float(min(max(p.start + p.width * x, p.low), p.high))
            for p, x in zip(self.parameters, z, strict=True)
        }

    def bounds(self) -> tuple[Vector, Vector]:
        """Return the bounds of the search."""
        low = np.array([(p.low - p.start) / p.width for p in self.parameters])
        return low, np.array([(p.high - p.start) / p.width for p in self.parameters])

    def errors(self, z: Vector) -> Errors:
        """Return the prediction errors at a point of the search."""
        values = self.values(z)
        model = self.plant_at(values)
        try:
            return model_errors(model, self.data, self.dt, self.offsets)
        except DataError:
            raise
        except Exception as error:  # of a user's equations too
            raise ModelError(f"{self.plant_at.words(values)}: {error}") from error

    def sensitivities(self, z: Vector, weights: Matrix) -> list[NDArray[np.float64]]:
        """Return the derivatives of the weighted errors by differences of second order, one-sided at a bound."""
        low, high = self.bounds()
        columns: list[list[Matrix]] = []
        for i, p in enumerate(self.parameters):
            size = max(abs(p.start + p.width * z[i]) / p.width, _LEAST_STEP)
            h = _STEP * min(size, 1.0)
            if z[i] - h >= low[i] and z[i] + h <= high[i]:
                places, factors = (h, -h), (0.5, -0.5)
            else:
                h = h if z[i] + 2 * h <= high[i] else -h
                places, factors = (0.0, h, 2 * h), (-1.5, 2.0, -0.5)
            step = np.eye(len(z))[i]
            at = [self.errors(z + place * step).projected(weights) for place in places]
            columns.append(
                [sum(f * e for f, e in zip(factors, parts, strict=True)) / h for parts in zip(*at, strict=True)]
            )
        return [np.stack(parts, axis=-1) for parts in zip(*columns, strict=True)]

    def prior_rows(self, z: Vector) -> tuple[Vector, Matrix]:
        """Return the errors of the priors and their derivatives."""
        mean, spread = self.priors
        known = np.isfinite(spread)
        return ((z - mean) / spread)[known], np.diag(1 / spread)[known]


class Found(NamedTuple):
    """The end of a search."""

    z: Vector
    weights: Matrix
    covariance: Matrix
    at_bound: NDArray[np.bool_]
    notes: tuple[str, ...]


def search(task: Task, starts: int, tell: Progress) -> Found:
    r"""Return the parameters with the least determinant of the covariance of the prediction errors.

    Least squares within bounds (trust region, reflective), with the errors weighted by their covariance; estimate and
    weights take turns until they stand, which is where :math:`\log\det \sum_t e_t e_t^T` is stationary.
    """
    from scipy.optimize import least_squares  # slow to import, and not needed to run a monitor

    z, start_notes = _best_start(task, starts, tell)
    signal = np.sqrt(
        np.mean(np.concatenate([np.diff(d[:, -task.n_outputs :], axis=0) ** 2 for d in task.data]), axis=0)
    )
    signal = np.maximum(signal, np.std(np.vstack([d[:, -task.n_outputs :] for d in task.data]), axis=0))
    low, high = task.bounds()
    notes: tuple[str, ...] = ()
    for turn in range(_MOST_TURNS):
        covariance, tried = _covariance(task, z), count(1)
        weights, notes = weights_of(covariance, signal)

        def residuals(at: Vector, W: Matrix = weights, n: int = turn, tried: Iterator[int] = tried) -> Vector:
            tell(f"search, turn {n + 1}", min(next(tried), _MOST_TRIED), _MOST_TRIED)
            return np.concatenate([*(e.ravel() for e in task.errors(at).projected(W)), task.prior_rows(at)[0]])

        def slopes(at: Vector, W: Matrix = weights) -> Matrix:
            rows = [S.reshape(-1, len(at)) for S in task.sensitivities(at, W)]
            return np.vstack([*rows, task.prior_rows(at)[1]])

        inside = np.clip(z, low, high)
        fit = least_squares(
            residuals,
            inside,
            slopes,
            bounds=(low, high),
            method="trf",
            xtol=RESPONSE_ROUNDING,
            ftol=RESPONSE_ROUNDING,
            gtol=RESPONSE_ROUNDING,
            max_nfev=_MOST_TRIED,
        )
        moved = np.linalg.norm(np.asarray(fit.jac) @ (fit.x - z))  # in standard errors, along what the data say
        z = fit.x
        if moved <= _STANDS:
            break
    else:
        notes += (
            f"the estimate had not settled after {_MOST_TURNS} turns of estimate and weights: the last one moved it by "
            f"{number(float(moved), 2)} standard errors",
        )
    near = ((z - low <= _AT_BOUND) & (fit.grad > 0)) | ((high - z <= _AT_BOUND) & (fit.grad < 0))
    z = np.where(near & (fit.grad > 0), low, np.where(near, high, z))
    covariance = _covariance(task, z)
    return Found(z, weights_of(covariance, signal)[0], covariance, near, (*start_notes, *notes))


def _covariance(task: Task, z: Vector) -> Matrix:
    """Return the covariance of the errors, start and offsets being fitted with weights of their own first."""
    errors = task.errors(z)
    spread = np.sqrt(np.mean(np.vstack(errors.raw) ** 2, axis=0))
    size = np.where(spread > 0, spread, 1.0)
    for _ in range(2):
        covariance = error_covariance([e * size for e in errors.projected(np.diag(1 / size))], errors.unknowns)
        spread = np.sqrt(np.diag(covariance))
        size = np.where(spread > 0, spread, size)
    return covariance


def _best_start(task: Task, starts: int, tell: Progress) -> tuple[Vector, tuple[str, ...]]:
    """Return the start, or the best of points that fill the box evenly where the user has given none."""
    k = len(task.parameters)
    best, least, failures = np.zeros(k), np.inf, []
    low, high = task.bounds()
    root = _EVENLY
    for _ in range(60):
        root = (1 + root) ** (1 / (k + 1))
    for j in range(max(starts, 1)):
        z = low + (high - low) * ((0.5 + j * root ** -np.arange(1.0, k + 1)) % 1.0) if j else np.zeros(k)
        if starts < 2:
            return z, ()
        tell("starts", j, starts)
        try:
            value = float(np.linalg.slogdet(_covariance(task, z))[1])
        except ModelError as error:
            failures.append(error)
            continue
        if value < least:
            best, least = z, value
    if len(failures) == starts:
        raise failures[0]
    notes = (
        (f"{len(failures)} of {starts} starts within the bounds could not be tried: {failures[0]}",) if failures else ()
    )
    return best, notes
