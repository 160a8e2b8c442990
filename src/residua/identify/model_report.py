"""What a user should know of a state-space model that was identified: its order and why, beside how well it fits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.design.core.evidence import format_pole
from residua.identify.fit_report import FitReport, share
from residua.shown import Shown
from residua.words import counted

#: Orders that a text lists on each side of the chosen one.
_AROUND = 3


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class IdentificationReport(Shown, FitReport):
    """How a model came about and how good it is.

    Attributes
    ----------
    method : str
    inputs, outputs : tuple of str
    dt : float
        In seconds.
    order : int
    order_reason : str
    singular_values : ndarray
        By how much each candidate state matters, as the method weights it.
    orders : tuple of int
        The orders that were compared.
    criterion : ndarray
        Schwarz's criterion of each; the smallest is zero.
    held_out_errors : ndarray
        Prediction error of each on the held-out part: the geometric mean over the outputs, relative to their
        standard deviations; NaN where nothing is held out, or no stable predictor exists.
    past : int
        Rows of the past from which the states are taken.
    samples : int
        Rows that the model is from.
    held_out : ErrorFacts or None
        On the part that was held out; ``None`` where nothing was.
    fitted : ErrorFacts
        On the part that the model is from.
    excitation : Excitation
    poles : ndarray of complex
        Of the plant.
    predictor_poles : ndarray of complex
    steady_gain : SteadyGain or None
        ``None`` for a plant with a pole at one, or without inputs.
    notes : tuple of str
    """

    order: int
    order_reason: str
    singular_values: NDArray[np.float64]
    orders: tuple[int, ...]
    criterion: NDArray[np.float64]
    held_out_errors: NDArray[np.float64]
    predictor_poles: NDArray[np.complex128]

    # ------------------------------------------------------------------ words

    def __str__(self) -> str:
        head = (
            f"model of order {self.order} by {self.method}: {counted(len(self.inputs), 'input')}, "
            f"{counted(len(self.outputs), 'output')}, {self.samples} rows at {self.dt:g} s, "
            f"{counted(self.past, 'row')} of the past"
        )
        poles = ", ".join(format_pole(one) for one in self.poles[:8]) or "none"
        more = " ..." if len(self.poles) > 8 else ""
        lines = [head, f"order: {self.order_reason}", *self._order_table(), f"poles: {poles}{more}", ""]
        remarks = [f"- {line}" for line in self.remarks]
        return "\n".join([*lines, *self.fit_table(), *(["", *remarks] if remarks else [])])

    def _order_table(self) -> list[str]:
        near = [k for k, order in enumerate(self.orders) if abs(order - self.order) <= _AROUND]
        rows = [("order", [str(self.orders[k]) for k in near])]
        values = [
            f"{self.singular_values[self.orders[k] - 1]:.3g}"
            if 0 < self.orders[k] <= len(self.singular_values)
            else "-"
            for k in near
        ]
        rows += [
            ("singular value", values),
            ("information criterion", [f"{self.criterion[k]:.1f}" for k in near]),
            ("held-out error", [share(self.held_out_errors[k]) for k in near]),
        ]
        return [f"  {name:<22}" + "".join(f"{cell:>11}" for cell in cells) for name, cells in rows]
