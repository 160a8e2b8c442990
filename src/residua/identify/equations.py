"""Linear equations, one for each output, by least squares from the factor of a Hankel matrix; and their state space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from residua.errors import DataError
from residua.identify.hankel_factor import HankelFactor
from residua.identify.horizon import NOISE_FREE
from residua.identify.realisation import Innovations
from residua.tolerances import DATA_ROUNDING
from residua.words import counted, listing

Matrix = NDArray[np.float64]
#: Signals that a message names at most, and the part of the largest from which on one is named.
_NAMED, _SHARE = 4, 0.05


@dataclass(frozen=True)
class Shape:
    """Which signals an equation has.

    Attributes
    ----------
    order : int
        Rows of the past.
    coupled : bool
        Whether it has the past of the other outputs too.
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
    """Return for each column of a triangular factor what the columns before it leave of it, as a part of its size."""
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
    r"""All equations of a model, :math:`y_{i,k} = c_i + \theta_i^T \varphi_{i,k} + e_{i,k}`, in units of the factor."""

    each: tuple[FittedEquation, ...]
    n_inputs: int
    windows: int

    @property
    def past(self) -> int:
        """Rows of the past in the longest equation."""
        return max(one.shape.order for one in self.each)

    @cached_property
    def error_covariance(self) -> Matrix:
        """Covariance of the equation errors, each product over the windows less the coefficients of both."""
        E = np.array([one.residual for one in self.each])
        left = np.sqrt([self.windows - 1 - len(one.terms) for one in self.each])
        E = np.where((np.linalg.norm(E, axis=1) > NOISE_FREE * np.sqrt(self.windows))[:, None], E, 0.0) / left[:, None]
        return E @ E.T

    @cached_property
    def covariance(self) -> Matrix:
        r"""Covariance of all coefficients, those of the first equation first, without the constants.

        .. math:: \text{cov}(\theta_i, \theta_j) = V_{ij} X_i^+ (X_j^+)^T

        for errors that are white and do not depend on the past.
        """
        V = self.error_covariance
        # the true size of errors that count as none in the noise of the model: an error of the estimate all the same
        P = [one.inverse[1:] for one in self.each]
        return np.block([[V[i, j] * (P[i] @ P[j].T) for j in range(len(P))] for i in range(len(P))])

    def with_values(self, values: Matrix) -> Equations:
        """Return the same equations with other coefficients, those of the first one first."""
        parts = np.split(values, np.cumsum([len(one.terms) for one in self.each])[:-1])
        each = tuple(
            FittedEquation(one.shape, one.terms, one.constant, part, one.residual, one.inverse)
            for one, part in zip(self.each, parts, strict=True)
        )
        return Equations(each, self.n_inputs, self.windows)

    def coefficients(self) -> NDArray[np.float64]:
        """Return the coefficients as an array, shape (past + 1, outputs, channels): row 0 is the present one."""
        out = np.zeros((self.past + 1, len(self.each), self.n_inputs + len(self.each)))
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
        theta, m, p, past = self.coefficients(), self.n_inputs, len(self.each), self.past
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


def fit_equations(
    factor: HankelFactor, shapes: Sequence[Shape], names: tuple[str, ...], *, feedthrough: bool
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
            raise DataError(_determined_text(T, left, terms, shape, names, names[m + i]))
        inverse = np.asarray(solve_triangular(T, Q.T), dtype=float)
        theta = inverse @ y
        each.append(FittedEquation(shape, terms, float(theta[0]), theta[1:], y - X @ theta, inverse))
    return Equations(tuple(each), m, factor.windows)


def _determined_text(
    T: Matrix, left: Matrix, terms: Sequence[Term], shape: Shape, names: tuple[str, ...], output: str
) -> str:
    """Return which signal of an equation follows from which others."""

    def text(term: Term) -> str:
        return repr(names[term[0]]) + (f" {counted(term[1], 'row')} before" if term[1] else "")

    first = int(np.argmax(left <= DATA_ROUNDING))
    size = np.linalg.norm(T[:, :first], axis=0)
    share = np.abs(np.linalg.solve(T[:first, :first], T[:first, first]) * size)[1:]
    largest = [k for k in np.argsort(-share, kind="stable")[:_NAMED] if share[k] > _SHARE * share.max()]
    row = terms[first - 1][1]
    return (
        f"the equation of {output!r} with {counted(shape.order, 'row')} of the past is not determined: "
        f"{text(terms[first - 1])} follows from {listing(text(terms[k]) for k in sorted(largest))} but for "
        f"{left[first]:.2g} of its size; ask for a lower order (below {max(row, 1)}), move the inputs more freely, or "
        "leave a channel out that follows from others"
    )
