"""What a user should know of equations that were identified: their coefficients with errors, orders and why, fit."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from residua.design.core.evidence import format_pole
from residua.identify.arx_orders import EquationChoice
from residua.identify.fit_report import FitReport, share
from residua.shown import Shown
from residua.words import counted

#: Terms of an equation that a text shows.
_SHOWN = 12
#: Orders that a text lists on each side of the chosen one.
_AROUND = 3


@dataclass(frozen=True, eq=False, repr=False)
class Equation:
    r"""The equation of one output, in deviations from the operating point and in the units of the channels.

    .. math:: y_k = \sum_j \theta_j\, z_{j, k - l_j} + e_k

    Attributes
    ----------
    output : str
    order : int
        Rows of the past, delays not counted.
    coupled : bool
        Whether it has the past of the other outputs too.
    terms : tuple of (str, int)
        Of each coefficient: the channel, and how many rows before it is read, delays included.
    coefficients, standard_errors : ndarray, shape (terms,)
    covariance : ndarray, shape (terms, terms)
        Of the coefficients.
    error : float
        Standard deviation of the equation error.
    choice : EquationChoice
        The orders that were compared, with the criterion and the error on the held-out part.
    """

    output: str
    order: int
    coupled: bool
    terms: tuple[tuple[str, int], ...]
    coefficients: NDArray[np.float64]
    standard_errors: NDArray[np.float64]
    covariance: NDArray[np.float64]
    error: float
    choice: EquationChoice = field(repr=False)

    def __str__(self) -> str:
        parts = [
            f"{value:.4g} (± {error:.2g}) {name}{f'[k-{row}]' if row else '[k]'}"
            for (name, row), value, error in zip(self.terms, self.coefficients, self.standard_errors, strict=True)
        ]
        more = len(parts) - _SHOWN
        shown = [*parts[:_SHOWN], f"and {more} more"] if more > 1 else parts
        return f"{self.output}[k] = {' + '.join([*shown, 'e'])}"

    def __repr__(self) -> str:
        return f"Equation({self.output!r}, order {self.order}, {counted(len(self.terms), 'coefficient')})"

    def table(self) -> list[str]:
        """Return the lines of the table of orders around the one that was chosen."""
        kind = int(self.coupled)
        near = [order for order in self.choice.orders if abs(order - self.order) <= _AROUND]
        values = self.choice.criterion[kind]
        rows = [
            ("order", [str(order) for order in near]),
            ("information criterion", [f"{values[k]:.1f}" if np.isfinite(values[k]) else "-" for k in near]),
            ("held-out error", [share(float(self.choice.held_out_errors[kind, k])) for k in near]),
        ]
        return [f"  {name:<22}" + "".join(f"{cell:>11}" for cell in cells) for name, cells in rows]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class EquationReport(Shown, FitReport):
    """How the equations of a model came about and how good they are.

    Attributes
    ----------
    method : str
    inputs, outputs : tuple of str
    dt : float
        In seconds.
    equations : tuple of Equation
        One for each output.
    past : int
        Rows of the past of the longest equation.
    samples : int
        Rows that the model is from.
    held_out : ErrorFacts or None
        On the part that was held out; ``None`` where nothing was.
    fitted : ErrorFacts
        On the part that the model is from.
    excitation : Excitation
    poles : ndarray of complex
        Of the plant.
    steady_gain : SteadyGain or None
        With standard errors by the covariance of the coefficients; ``None`` for a plant with a pole at one, or
        without inputs.
    notes : tuple of str
    """

    equations: tuple[Equation, ...]

    @property
    def about_feedback(self) -> str:
        """What a controller that was at work does to the estimate."""
        return "which equations with white errors allow for, as long as it acts a row later"

    def __str__(self) -> str:
        lines = [
            f"{counted(len(self.equations), 'equation')} by {self.method}: {counted(len(self.inputs), 'input')}, "
            f"{self.samples} rows at {self.dt:g} s, {counted(self.past, 'row')} of the past"
        ]
        for one in self.equations:
            past = "the past of all outputs" if one.coupled else "its own past"
            lines += [
                "",
                f"{one.output}: order {one.order}, {past}",
                *one.table(),
                f"  {one.choice.reason}",
                f"  {one}",
            ]
        poles = ", ".join(format_pole(one) for one in self.poles[:8]) or "none"
        remarks = [f"- {line}" for line in self.remarks]
        lines += ["", f"poles: {poles}{' ...' if len(self.poles) > 8 else ''}", "", *self.fit_table()]
        return "\n".join([*lines, *(["", *remarks] if remarks else [])])
