"""The report on an identified model: fit, whiteness, excitation, and gains that the data leave open."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.design.core.evidence import format_pole
from residua.identify.channel_facts import ChannelFacts
from residua.identify.hankel_factor import HankelFactor, regress
from residua.identify.prediction import CHANCE, ErrorFacts, Innovations, error_facts, rows_to_forget
from residua.identify.segments import Gathered
from residua.linear.poles.spectrum import spectral_radius
from residua.plant import Identification
from residua.shown import Shown
from residua.tolerances import RANK
from residua.words import counted, listing, number

#: Standard errors that the effect of an input must reach to count as one.
_EFFECT = 4.0
#: An output's errors with a larger correlation than this, where chance is no reason, are called coloured.
_COLOURED = 0.1
#: Less than this of an input's variance is its own: the data hardly tell its effect from that of a controller.
_LITTLE = 1e-2
#: Rows on which a model is judged at most, of its own and of those that are held out.
_JUDGED = 500_000
#: The part of their size by which states may move in a row at the operating point without a word.
_UNBALANCED = 0.01
#: Orders that a text lists on each side of the chosen one.
_AROUND = 3


@dataclass(frozen=True, eq=False)
class Excitation:
    """The inputs of a recording, as far as a model depends on them.

    Attributes
    ----------
    unexplained : ndarray, shape (inputs,)
        The part of each input's variance that neither the past nor the other inputs determine (nor, without
        feedthrough, the outputs of the same row): from it alone the effect of the input is told from that of a
        controller.
    delays : ndarray of int, shape (outputs, inputs)
        The first row after which an input moves an output by more than four standard errors; -1 where none does
        within the past.
    instant : tuple of (int, int)
        Output and input that move together within a row.
    """

    unexplained: NDArray[np.float64]
    delays: NDArray[np.int_]
    instant: tuple[tuple[int, int], ...]


def excitation(factor: HankelFactor, past: int, *, feedthrough: bool) -> Excitation:
    """Return the excitation by the inputs, from windows of ``past`` rows and the one after them.

    Without feedthrough an input that goes with the output of its row is moved by it.
    """
    m = factor.n_inputs
    before = factor.R[:, [0, *factor.signals(range(past))]]
    u = factor.R[:, factor.inputs(past)]
    together = factor.R[:, [] if feedthrough else factor.outputs(past)]
    unexplained = np.ones(m)
    power = np.linalg.norm(u - np.outer(before[:, 0], before[:, 0] @ u) / (before[:, 0] @ before[:, 0]), axis=0)
    for i in range(m):
        rest = regress(u[:, [i]], np.hstack([before, np.delete(u, i, axis=1), together]))[1]
        unexplained[i] = float(np.linalg.norm(rest) / max(power[i], np.finfo(float).tiny)) ** 2
    # the first rows with an effect, by the standard errors of an autoregression with the inputs at each row
    p, n = factor.n_outputs, factor.n_channels
    columns = [0, *factor.signals(range(past)), *factor.inputs(past)]
    X, y = factor.R[:, columns], factor.R[:, factor.outputs(past)]
    coefficients, residual = regress(y, X)
    size = np.linalg.norm(X, axis=0)
    size = np.where(size > 0, size, 1.0)
    spread = np.linalg.norm(np.linalg.pinv(X / size, rcond=RANK), axis=1) / size
    noise = np.linalg.norm(residual, axis=0) / np.sqrt(max(factor.windows - len(columns), 1))
    scale = np.maximum(np.outer(noise, spread), np.finfo(float).tiny)
    strength = np.abs(coefficients) / scale
    now = strength[:, 1 + past * n :] > _EFFECT
    delays = np.full((p, m), -1)
    for row in reversed(range(1, past + 1)):
        first = 1 + (past - row) * n
        delays = np.where(strength[:, first : first + m] > _EFFECT, row, delays)
    pairs = tuple((int(i), int(j)) for i, j in zip(*np.nonzero(now), strict=True))
    return Excitation(unexplained, np.asarray(delays, dtype=int), pairs)


@dataclass(frozen=True, eq=False)
class SteadyGain:
    """Steady-state gains from inputs to outputs, with their standard errors.

    Attributes
    ----------
    gain : ndarray, shape (outputs, inputs)
    error : ndarray or None, shape (outputs, inputs)
        Standard errors, from estimates on parts of the data; infinite for an input that the past determines wholly,
        ``None`` where there are too few parts.
    """

    gain: NDArray[np.float64]
    error: NDArray[np.float64] | None

    def text(self, output: int, given: int) -> str:
        """Return one of them with its standard error, as far as that is known."""
        gain = number(float(self.gain[output, given]))
        if self.error is None:
            return gain
        error = float(self.error[output, given])
        return f"{gain} ± {number(error)}" if np.isfinite(error) else "unknown"


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class FitReport:
    """Base of the reports on identified models: prediction errors, excitation and remarks.

    Attributes
    ----------
    method : str
    inputs, outputs : tuple of str
    dt : float
        In seconds.
    past : int
        Rows of the past from which a row is predicted.
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
        ``None`` for a plant with a pole at one, or without inputs.
    notes : tuple of str
    """

    method: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dt: float
    past: int
    samples: int
    held_out: ErrorFacts | None
    fitted: ErrorFacts
    excitation: Excitation
    poles: NDArray[np.complex128]
    steady_gain: SteadyGain | None
    notes: tuple[str, ...]

    @property
    def checked(self) -> ErrorFacts:
        """The errors on the held-out part, or else on the part that the model is from."""
        return self.held_out or self.fitted

    @property
    def coloured(self) -> tuple[str, ...]:
        """The outputs whose prediction errors are correlated in time: the model misses some of their dynamics."""
        facts = self.checked
        strong = (facts.autocorrelation > _COLOURED) & (facts.whiteness < CHANCE)
        return tuple(name for name, one in zip(self.outputs, strong, strict=True) if one)

    @property
    def feedback(self) -> tuple[tuple[str, str], ...]:
        """The pairs of an output and an input that follows its errors: a controller was at work."""
        return tuple((output, given) for output, given, _ in self.fitted.feedback)

    @property
    def weak_inputs(self) -> tuple[str, ...]:
        """The inputs that the past determines almost wholly."""
        return tuple(name for name, one in zip(self.inputs, self.excitation.unexplained, strict=True) if one < _LITTLE)

    @property
    def uncertain_gains(self) -> tuple[tuple[str, str, float, float], ...]:
        """The steady-state gains the data do not determine: output, input, gain, standard error of over half of it."""
        if self.steady_gain is None or self.steady_gain.error is None:
            return ()
        gain, error = self.steady_gain.gain, self.steady_gain.error
        places = zip(*np.nonzero(error > 0.5 * np.abs(gain)), strict=True)
        return tuple((self.outputs[i], self.inputs[j], float(gain[i, j]), float(error[i, j])) for i, j in places)

    @property
    def no_simulation(self) -> str:
        """Reason for having no fit from inputs alone, in words; empty where there is one."""
        if self.checked.simulated_fit is not None:
            return ""
        if not self.inputs:
            return "there are no inputs"
        radius = float(np.abs(self.poles).max(initial=0.0))
        if radius >= 1:
            return f"a simulation never forgets its start, by a pole of size {radius:.4g}"
        return (
            f"the start of a simulation is left out until 1 % of it is left, {counted(rows_to_forget(radius), 'row')}, "
            f"and no stretch without a gap is more than twice as long"
        )

    @property
    def identification(self) -> Identification:
        """Summary that the plant carries, into files and for :func:`residua.suggest`."""
        gains = tuple((output, given) for output, given, _, _ in self.uncertain_gains)
        return Identification(self.method, self.samples, self.coloured, self.weak_inputs, gains)

    @property
    def about_feedback(self) -> str:
        """The effect on the estimate of a controller that was at work, in words."""
        if self.method == "ARX":
            return "which equations with white errors allow for, as long as it acts a row later"
        return "which this method allows for" if self.method == "PBSID" else "which biases this method: take 'pbsid'"

    def fit_lines(self) -> list[str]:
        """Return the poles, the table of fits, one output in each line, and the remarks."""
        facts = self.checked
        where = f"{facts.rows} rows held out" if self.held_out else f"the {facts.rows} rows that it is from"
        width = max(len(name) for name in self.outputs)
        lines = [f"on {where}:", f"  {'':<{width}}  one step ahead   from inputs   error rms   correlation in time"]
        for i, name in enumerate(self.outputs):
            simulated = "-" if facts.simulated_fit is None else share(facts.simulated_fit[i])
            coloured = "coloured" if name in self.coloured else "white enough"
            lines.append(
                f"  {name:<{width}}  {share(facts.fit[i]):>14}   {simulated:>11}   "
                f"{number(float(facts.error[i])):>9}   {facts.autocorrelation[i]:.2f} {coloured}"
            )
        poles = ", ".join(format_pole(one) for one in self.poles[:8]) or "none"
        lines = [f"poles: {poles}{' ...' if len(self.poles) > 8 else ''}", "", *lines]
        lines += [f"  no fit from inputs: {self.no_simulation}"] if self.no_simulation else []
        return [*lines, *([""] if self.remarks else []), *(f"- {line}" for line in self.remarks)]

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on the model in sentences: the notes, then those that follow from the numbers."""
        lines = list(self.notes)
        if self.feedback:
            pairs = listing(f"{given!r} follows {output!r}" for output, given in self.feedback[:4])
            lines.append(f"closed loop: {pairs}, {self.about_feedback}")
        for name in self.weak_inputs:
            free = self.excitation.unexplained[self.inputs.index(name)]
            lines.append(
                f"the past determines {name!r} but for {share(free)} of its variance: its effect is hardly "
                "told from that of a controller; move it on purpose (dither)"
            )
        if self.uncertain_gains:
            assert self.steady_gain is not None  # else there is none to be uncertain
            some = [
                f"{given!r} on {output!r}: "
                + self.steady_gain.text(self.outputs.index(output), self.inputs.index(given))
                for output, given, _, _ in self.uncertain_gains[:6]
            ]
            lines.append(f"steady-state gains the data do not determine: {listing(some)}")
        if self.coloured:
            lines.append(
                f"the errors of {listing(map(repr, self.coloured))} are correlated in time: its residuals are "
                "not white, so fit the threshold, with a window or persistence"
            )
        return tuple(lines)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class IdentificationReport(Shown, FitReport):
    """Report on an identified state-space model: its order, fit and remarks.

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

    def __str__(self) -> str:
        near = [k for k, order in enumerate(self.orders) if abs(order - self.order) <= _AROUND]
        values = {order: f"{value:.3g}" for order, value in enumerate(self.singular_values, 1)}
        return "\n".join(
            [
                f"model of order {self.order} by {self.method}: {counted(len(self.inputs), 'input')}, "
                f"{counted(len(self.outputs), 'output')}, {self.samples} rows at {self.dt:g} s, "
                f"{counted(self.past, 'row')} of the past",
                f"order: {self.order_reason}",
                *order_table(
                    {
                        "order": [str(self.orders[k]) for k in near],
                        "singular value": [values.get(self.orders[k], "-") for k in near],
                        "information criterion": [f"{self.criterion[k]:.1f}" for k in near],
                        "held-out error": [share(self.held_out_errors[k]) for k in near],
                    }
                ),
                *self.fit_lines(),
            ]
        )


def facts_of_fit(
    model: Innovations, first: Gathered, last: Gathered, facts: ChannelFacts, factor: HankelFactor, *, feedthrough: bool
) -> dict[str, Any]:
    """Return the attributes that every report has, but for its method and its steady gains."""
    least = 2 * model.past + 1
    excited = excitation(factor, model.past, feedthrough=feedthrough)
    fitted, held_out = (
        error_facts(model, part.shortened(_JUDGED, least), facts.mean, facts.units) for part in (first, last)
    )
    notes = [model.note] if model.note else []
    pairs = [f"{first.outputs[i]!r} with {first.inputs[j]!r}" for i, j in excited.instant]
    if pairs and not feedthrough:
        notes.append(
            f"within a row {', '.join(pairs[:4])} move together: feedthrough=True if the plant answers within a row; "
            "leave it if a controller does"
        )
    rows = max(map(len, last.segments), default=0)
    if rows and rows <= model.past:
        notes.append(
            f"nothing is judged on held-out rows: {rows} in a row, and a prediction needs {model.past} before it"
        )
    radius = float(spectral_radius(model.A))
    if radius >= 1:
        notes.append(f"the plant has a pole of size {radius:.6g}: it integrates, drifts, or was held by a controller")
    left = model.at_rest()[2]
    if left > _UNBALANCED:
        notes.append(f"no operating point balances the model: its states move by {left:.2g} a row at mean inputs")
    return {
        "inputs": first.inputs,
        "outputs": first.outputs,
        "dt": first.dt,
        "past": model.past,
        "samples": first.n_samples,
        "held_out": held_out,
        "fitted": fitted,
        "excitation": excited,
        "poles": np.linalg.eigvals(model.A).astype(complex),
        "notes": tuple(notes),
    }


def share(value: float) -> str:
    """Return a part of one in per cent; a dash where there is none."""
    return "-" if np.isnan(value) else f"{100 * value:.3g} %"


def order_table(rows: dict[str, list[str]]) -> list[str]:
    """Return the lines of a table of orders."""
    return [f"  {name:<22}" + "".join(f"{cell:>11}" for cell in cells) for name, cells in rows.items()]
