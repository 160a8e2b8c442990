"""What a user should know of any model that was identified: fit, whiteness, excitation, what the data cannot say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.identify.excitation import Excitation
from residua.identify.prediction import CHANCE, ErrorFacts, rows_to_forget
from residua.plant import Identification
from residua.words import counted, listing, number

#: An output's errors with a larger correlation than this, where chance is no reason, are called coloured.
_COLOURED = 0.1
#: Less than this of an input's variance is its own: the data hardly tell its effect from that of a controller.
_LITTLE = 1e-2


@dataclass(frozen=True, eq=False)
class SteadyGain:
    """What a constant input does to the outputs in the end, and how well the data say so.

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
    """What the prediction errors and the inputs say of a model, however it was identified.

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
        """Why no fit from inputs alone is given, in words; empty where one is."""
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
        """What the plant carries of this, into files and for :func:`residua.suggest`."""
        gains = tuple((output, given) for output, given, _, _ in self.uncertain_gains)
        return Identification(self.method, self.samples, self.coloured, self.weak_inputs, gains)

    @property
    def about_feedback(self) -> str:
        """What a controller that was at work does to the estimate."""
        return "which this method allows for" if self.method == "PBSID" else "which biases this method: take 'pbsid'"

    # ------------------------------------------------------------------ words

    def fit_table(self) -> list[str]:
        """Return the lines of the table of fits, one output in each."""
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
        return [*lines, *([f"  no fit from inputs: {self.no_simulation}"] if self.no_simulation else [])]

    @property
    def remarks(self) -> tuple[str, ...]:
        """What should be known of the model, in sentences: the notes, then what the numbers say."""
        lines = list(self.notes)
        if self.feedback:
            pairs = listing(f"{given!r} follows {output!r}" for output, given in self.feedback[:4])
            lines.append(f"closed loop: {pairs}, {self.about_feedback}")
        for name in self.weak_inputs:
            own = self.excitation.unexplained[self.inputs.index(name)]
            lines.append(
                f"the past determines {name!r} but for {share(own)} of its variance: its effect is hardly "
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


def share(value: float) -> str:
    """Return a part of one in per cent; a dash where there is none."""
    return "-" if np.isnan(value) else f"{100 * value:.3g} %"
