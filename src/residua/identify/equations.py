"""Linear equations, one for each output: their orders, their least-squares fit, and their plant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from residua.errors import DataError, SettingError
from residua.identify.channel_facts import ChannelFacts
from residua.identify.fit_report import SteadyGain
from residua.identify.hankel_factor import NOISE_FREE, HankelFactor, count_windows, discounted_factor
from residua.identify.identified_model import plant_of, with_input_delays
from residua.identify.prediction import Innovations
from residua.identify.segments import Gathered
from residua.linear import PolynomialMatrix
from residua.linear.subspaces.rank import range_basis
from residua.plant import InputOutputModel, Plant
from residua.tolerances import DATA_ROUNDING, POLE
from residua.words import counted, listing

Matrix = NDArray[np.float64]
#: Signals that a message names at most, and the part of the largest from which on one is named.
_NAMED, _SHARE = 4, 0.05
#: Held-out rows on which orders are compared.
_ROWS = 50_000
#: Orders that are compared at most, unless the caller says otherwise; and columns of the Hankel matrix for them.
_MOST_ORDERS, _MOST_COLUMNS = 20, 400
#: Rows for each column from which on an order is compared.
_LEAST_ROWS = 4
#: An order is compared if at least this part of the rows has as many before it.
_LEAST_SHARE = 0.5
#: Coefficients whose covariance is taken apart at most.
_MOST_COEFFICIENTS = 2000


@dataclass(frozen=True)
class Shape:
    """The signals of an equation.

    Attributes
    ----------
    order : int
        Rows of the past.
    coupled : bool
        True where it has the past of the other outputs too.
    """

    order: int
    coupled: bool


Term = tuple[int, int]
"""A channel, inputs first, and how many rows before."""


def terms_of(shape: Shape, output: int, n_inputs: int, n_outputs: int, *, feedthrough: bool) -> list[Term]:
    """Return the regressors of the equation of an output, the nearest rows first."""
    outputs = range(n_outputs) if shape.coupled else [output]
    channels = [*range(n_inputs), *(n_inputs + j for j in outputs)]
    now = [(j, 0) for j in range(n_inputs)] if feedthrough else []
    return now + [(channel, row) for row in range(1, shape.order + 1) for channel in channels]


def columns_of(factor: HankelFactor, terms: Sequence[Term]) -> list[int]:
    """Return the columns of the factor for the constant and the terms, counted from the last row of the window."""
    last = factor.length - 1
    return [0, *(1 + (last - row) * factor.n_channels + channel for channel, row in terms)]


def determined(triangle: Matrix) -> Matrix:
    """Return the part of each column of a triangular factor that the columns before it do not explain."""
    size = np.linalg.norm(triangle, axis=0)
    return np.abs(np.diag(triangle)) / np.where(size > 0, size, 1.0)


@dataclass(frozen=True, eq=False)
class FittedEquation:
    """The equation of one output, in units of the factor.

    Attributes
    ----------
    shape : Shape
    terms : list of (int, int)
    constant : float
    values : ndarray, shape (terms,)
    residual : ndarray, shape (rows of the factor,)
        Its products are those of the equation errors.
    inverse : ndarray, shape (1 + terms, rows of the factor)
        The pseudo-inverse of the regressors, the constant first.
    """

    shape: Shape
    terms: list[Term]
    constant: float
    values: Matrix
    residual: Matrix
    inverse: Matrix


@dataclass(frozen=True, eq=False)
class Equations:
    r"""All equations of a model, :math:`y_{i,k} = c_i + \theta_i^T \varphi_{i,k} + e_{i,k}`, in units of the factor.

    Attributes
    ----------
    each : tuple of FittedEquation
        One for each output.
    windows : int
        Windows that they are from.
    inputs, outputs : tuple of str
    dt : float
    reference, units : ndarray, shape (channels,)
        The values subtracted from each channel, and the divisors.
    delays : mapping of str to int
        Rows by which an input acts late, beside those of the terms.
    """

    each: tuple[FittedEquation, ...]
    windows: int
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dt: float
    reference: Matrix
    units: Matrix
    delays: Mapping[str, int]

    @property
    def past(self) -> int:
        """Rows of the past in the longest equation."""
        return max(one.shape.order for one in self.each)

    @cached_property
    def error_covariance(self) -> Matrix:
        """Covariance of the equation errors, each product over the windows less the coefficients of both."""
        E = np.array([one.residual for one in self.each])
        root = np.sqrt([self.windows - 1 - len(one.terms) for one in self.each])
        E = np.where((np.linalg.norm(E, axis=1) > NOISE_FREE * np.sqrt(self.windows))[:, None], E, 0.0) / root[:, None]
        return E @ E.T

    @cached_property
    def covariance(self) -> Matrix:
        r"""Covariance of all coefficients, those of the first equation first, without the constants.

        .. math:: \text{cov}(\theta_i, \theta_j) = V_{ij} X_i^+ (X_j^+)^T

        for errors that are white and do not depend on the past.
        """
        V, P = self.error_covariance, [one.inverse[1:] for one in self.each]
        return np.block([[V[i, j] * (P[i] @ P[j].T) for j in range(len(P))] for i in range(len(P))])

    def scale(self) -> list[Matrix]:
        """Return the factors that take the coefficients of each equation to the units of the recordings."""
        m = len(self.inputs)
        return [
            self.units[m + i] / np.array([self.units[channel] for channel, _ in one.terms])
            for i, one in enumerate(self.each)
        ]

    def coefficients(self) -> NDArray[np.float64]:
        """Return the coefficients as an array, shape (past + 1, outputs, channels): row 0 is the present one."""
        out = np.zeros((self.past + 1, len(self.each), len(self.units)))
        for i, one in enumerate(self.each):
            for (channel, row), value in zip(one.terms, one.values, strict=True):
                out[row, i, channel] = value
        return out

    def innovations(self) -> Innovations:
        r"""Return the same in state space, with as many states for each output as its equation has rows of the past.

        .. math::

           x_{i,l}[k+1] = x_{i,l+1}[k] + a_{i,l}^T y_k + b_{i,l}^T u_k, \qquad
           y_{i,k} = x_{i,1}[k] + d_i^T u_k + c_i + e_{i,k}

        The predictor has all its poles at zero: it forgets its start after the rows of the past.
        """
        theta, m, p, past = self.coefficients(), len(self.inputs), len(self.each), self.past
        orders = [one.shape.order for one in self.each]
        starts = np.cumsum([0, *orders])
        n = int(starts[-1])
        shift, C, ahead = np.zeros((n, n)), np.zeros((p, n)), np.zeros((n, m + p))
        states = np.zeros((n, past, m + p))
        for i, order in enumerate(orders):
            a = int(starts[i])
            if order:
                C[i, a] = 1.0
            for row in range(1, order + 1):
                ahead[a + row - 1] = theta[row, i]
                if row < order:
                    shift[a + row - 1, a + row] = 1.0
                for later in range(row, order + 1):  # of the row that was (later - row + 1) rows before the next
                    states[a + row - 1, past - 1 - (later - row)] = theta[later, i]
        D, by_inputs, K = theta[0, :, :m], ahead[:, :m], ahead[:, m:]
        constant = np.array([one.constant for one in self.each])
        return Innovations(
            shift + K @ C,
            by_inputs + K @ D,
            C,
            D,
            K,
            K @ constant,
            constant,
            self.error_covariance,
            states.reshape(n, past * (m + p)),
            past,
        )

    def plant(self, **options: object) -> tuple[Plant, Matrix]:
        """Return the plant in the units of the recordings, and the covariance of the equation errors."""
        around = (self.inputs, self.outputs, self.dt, self.reference, self.units)
        plant, _, V = plant_of(self.innovations(), *around, **options)
        return with_input_delays(plant, self.delays), V

    def directions(self, most: int) -> tuple[Matrix, list[dict[str, Matrix]]]:
        """Return the largest standard deviations of the coefficients, and their effects on the plant's matrices."""
        count = sum(len(one.terms) for one in self.each)
        if count > _MOST_COEFFICIENTS:
            raise SettingError(
                f"the covariance of {count} coefficients, over {_MOST_COEFFICIENTS}, is too large to take apart: "
                "ask for fewer, with past_of='own' or a lower order"
            )
        root, decision = range_basis(self.covariance)
        keep = min(most, decision.rank)
        sizes = np.sqrt(decision.singular_values[:keep])
        cuts = np.cumsum([len(one.terms) for one in self.each])[:-1]
        effects = []
        for size, direction in zip(sizes, root.T, strict=False):
            step, ends = size if size > 0 else 1.0, []
            for sign in (1, -1):
                parts = np.split(sign * step * direction, cuts)
                each = (replace(one, values=one.values + part) for one, part in zip(self.each, parts, strict=True))
                ends.append(replace(self, each=tuple(each)).plant()[0])
            up, down = ends
            effects.append({name: (getattr(up, name) - getattr(down, name)) / (2 * step) for name in "ABCD"})
        return sizes, effects

    def model(self, *, name: str, units: Mapping[str, str] | None, plant: Plant) -> InputOutputModel:
        """Return the equations as polynomials, in the units of the recordings."""
        m, p, late = len(self.inputs), len(self.outputs), max(self.delays.values(), default=0)
        past = self.past
        theta = self.coefficients() * self.units[m:, None] / self.units
        H, G = np.zeros((past + 1, p, p)), np.zeros((past + late + 1, p, m))
        H[0], H[1:] = np.eye(p), -theta[1:, :, m:]
        for j, given in enumerate(self.inputs):
            rows = self.delays.get(given, 0)
            G[rows : rows + past + 1, :, j] = theta[:, :, j]
        return InputOutputModel(
            PolynomialMatrix(H),
            PolynomialMatrix(G),
            dt=self.dt,
            variable="1/z",
            inputs=self.inputs,
            outputs=self.outputs,
            name=name,
            units=units,
            operating_point=plant.operating_point,
        )

    def steady_gain(self) -> SteadyGain | None:
        r"""Return the effect of constant inputs in the end, with its standard errors by those of the coefficients.

        .. math::

           S = M^{-1} N, \quad M = I - \sum_l A_l, \quad N = \sum_l B_l, \qquad dS = M^{-1} (dN + \sum_l dA_l\, S)
        """
        m, theta = len(self.inputs), self.coefficients().sum(axis=0)
        poles = np.linalg.eigvals(self.innovations().A)
        if not m or (len(poles) and np.abs(poles - 1).min() < POLE):
            return None
        M = np.linalg.inv(np.eye(len(theta)) - theta[:, m:])
        gain = M @ theta[:, :m]
        rest = np.vstack([np.eye(m), gain])  # each channel at rest for each input
        variance = np.zeros(gain.shape)
        for r, j in np.ndindex(gain.shape):
            moved = [M[r, i] * rest[[c for c, _ in one.terms], j] @ one.inverse[1:] for i, one in enumerate(self.each)]
            variance[r, j] = max(float(np.sum(self.error_covariance * (np.array(moved) @ np.array(moved).T))), 0.0)
        scale = self.units[m:, None] / self.units[:m]
        return SteadyGain(gain * scale, np.sqrt(variance) * scale)


def fit_equations(
    factor: HankelFactor,
    shapes: Sequence[Shape],
    gathered: Gathered,
    facts: ChannelFacts,
    delays: Mapping[str, int],
    *,
    feedthrough: bool,
) -> Equations:
    """Return the least-squares fit of the equation of each output.

    Raises
    ------
    DataError
        If some of the regressors determine another one.
    """
    m, p, last = factor.n_inputs, factor.n_outputs, factor.length - 1
    each = []
    for i, shape in enumerate(shapes):
        terms = terms_of(shape, i, m, p, feedthrough=feedthrough)
        X, y = factor.R[:, columns_of(factor, terms)], factor.R[:, factor.outputs(last)[i]]
        Q, T = np.linalg.qr(X)
        left = determined(T)
        if left.min() <= DATA_ROUNDING:
            text = [
                repr(gathered.channels[channel]) + (f" {counted(row, 'row')} before" if row else "")
                for channel, row in terms
            ]
            first = int(np.argmax(left <= DATA_ROUNDING))
            size = np.linalg.norm(T[:, :first], axis=0)
            share = np.abs(np.linalg.solve(T[:first, :first], T[:first, first]) * size)[1:]
            largest = [k for k in np.argsort(-share, kind="stable")[:_NAMED] if share[k] > _SHARE * share.max()]
            raise DataError(
                f"the equation of {gathered.outputs[i]!r} with {counted(shape.order, 'row')} of the past is not "
                f"determined: {text[first - 1]} follows from {listing(text[k] for k in sorted(largest))} but for "
                f"{left[first]:.2g} of its size; ask for a lower order (below {max(terms[first - 1][1], 1)}), move the "
                "inputs more freely, or leave a channel out that follows from others"
            )
        inverse = np.asarray(solve_triangular(T, Q.T), dtype=float)
        theta = inverse @ y
        each.append(FittedEquation(shape, terms, float(theta[0]), theta[1:], y - X @ theta, inverse))
    around = (gathered.inputs, gathered.outputs, gathered.dt, facts.mean, facts.units)
    return Equations(tuple(each), factor.windows, *around, delays)


@dataclass(frozen=True, eq=False)
class EquationChoice:
    """The shape of one equation, beside the others that were compared.

    Attributes
    ----------
    shape : Shape
    reason : str
    orders : tuple of int
    criterion : ndarray, shape (2, orders)
        Schwarz's, by the own past and by that of all outputs; the smallest is zero, those that the data do not
        determine, or that were not asked for, are infinite.
    held_out_errors : ndarray, shape (2, orders)
        Prediction error on the held-out part, relative to the output's standard deviation; NaN where there is none.
    """

    shape: Shape
    reason: str
    orders: tuple[int, ...]
    criterion: Matrix
    held_out_errors: Matrix


def most_orders(gathered: Gathered) -> int:
    """Return the largest order that is compared by default: one that most rows have before them."""
    n = len(gathered.channels)
    most = max(min(_MOST_ORDERS, _MOST_COLUMNS // n), 1)
    enough = _LEAST_SHARE * count_windows(gathered, 2)
    while most > 1 and count_windows(gathered, most + 1) < max(enough, _LEAST_ROWS * (1 + n * (most + 1))):
        most -= 1
    return most


def choose_equations(
    factor: HankelFactor,
    held_out: Gathered,
    orders: Mapping[str, int] | Literal["auto"],
    past_of: str,
    *,
    feedthrough: bool,
) -> tuple[EquationChoice, ...]:
    """Return the shape of the equation of each output, by Schwarz's criterion where no order is asked for."""
    m, p, most = factor.n_inputs, factor.n_outputs, factor.length - 1
    criterion, share = np.full((p, 2, most + 1), np.inf), np.full((p, 2, most + 1), np.nan)
    nothing = replace(factor, R=np.zeros_like(factor.R), windows=0)
    unseen = discounted_factor(nothing, held_out.shortened(_ROWS, 2 * factor.length), 1.0)
    H, targets = unseen.R, factor.outputs(most)
    spread = np.linalg.norm(H[:, targets] - np.outer(H[:, 0], H[:, 0] @ H[:, targets]) / max(unseen.windows, 1), axis=0)
    spread = np.where(spread > 0, spread, 1.0)
    kinds = [coupled for coupled in (False, True) if past_of in ("auto", "all" if coupled else "own")]
    kinds = [False] if p == 1 else kinds
    for coupled in kinds:
        for group in [list(range(p))] if coupled else [[i] for i in range(p)]:
            columns = columns_of(factor, terms_of(Shape(most, coupled), group[0], m, p, feedthrough=feedthrough))
            responses, d = [targets[i] for i in group], len(columns)
            T = np.asarray(np.linalg.qr(factor.R[:, [*columns, *responses]], mode="r"))
            left = determined(T[:d, :d])
            for order in range(most + 1):
                k = d - (most - order) * (m + (p if coupled else 1))
                if left[:k].min() <= DATA_ROUNDING:
                    continue
                error = np.maximum(np.linalg.norm(T[k:, d:], axis=0) / np.sqrt(factor.windows), NOISE_FREE)
                criterion[group, int(coupled), order] = 2 * factor.windows * np.log(error) + k * np.log(factor.windows)
                if unseen.windows:
                    theta = solve_triangular(T[:k, :k], T[:k, d:])
                    errors = np.linalg.norm(H[:, responses] - H[:, columns[:k]] @ theta, axis=0)
                    share[group, int(coupled), order] = errors / spread[group]
    wanted = {} if orders == "auto" else orders
    return tuple(
        _choice(criterion[i], share[i], wanted.get(name), p, richest=kinds[-1])
        for i, name in enumerate(held_out.outputs)
    )


def _choice(criterion: Matrix, share: Matrix, wanted: int | None, n_outputs: int, *, richest: bool) -> EquationChoice:
    """Return the choice for one output; ``richest``: the past of all outputs was compared too."""
    orders = tuple(range(criterion.shape[1]))
    compared = criterion if wanted is None else criterion[:, [wanted]]
    if np.isfinite(compared).any():
        kind, place = np.unravel_index(int(compared.argmin()), compared.shape)
        best = int(place) if wanted is None else wanted
    else:  # the fit says which signal the others determine
        kind, best = int(richest), wanted or 0
    coupled = bool(kind)
    reason = "as asked for" if wanted is not None else "the smallest information criterion"
    finite = np.isfinite(criterion).any(axis=0)
    last = int(np.flatnonzero(finite)[-1]) if finite.any() else 0
    if wanted is None and best == last == orders[-1] and best:
        reason += ", which is still falling at the largest order that was compared (max_order)"
    elif last < orders[-1]:
        reason += f"; the data do not determine more than {counted(last, 'row')} of the past"
    if np.isfinite(share).any():
        lowest = int(np.nanargmin(np.where(np.isnan(share[int(coupled)]), np.inf, share[int(coupled)])))
        reason += f"; the held-out error is smallest at order {lowest}"
    other = criterion[1 - int(coupled)]
    if n_outputs > 1 and np.isfinite(other).any() and np.isfinite(compared).any():
        more = float((other if wanted is None else other[[wanted]]).min() - compared.min())
        what = "its own past alone" if coupled else "the past of the other outputs too"
        if np.isfinite(more):
            reason += f"; with {what} the criterion is {more:.1f} higher"
    least = float(compared.min()) if np.isfinite(compared).any() else 0.0
    least = float(criterion.min()) if np.isfinite(criterion).any() else least
    return EquationChoice(Shape(best, coupled), reason, orders, criterion - least, share)
