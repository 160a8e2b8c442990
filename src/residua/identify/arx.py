"""One linear equation for each output from recordings, by least squares (ARX)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import index_of
from residua.errors import ModelError, SettingError
from residua.identify.channel_facts import channel_facts
from residua.identify.equations import EquationChoice, Equations, choose_equations, fit_equations, most_orders
from residua.identify.fit_report import FitReport, facts_of_fit, order_table, share
from residua.identify.hankel_factor import hankel_factor
from residua.identify.identified_model import RecordedModel
from residua.identify.segments import Names, checked_count, gather
from residua.plant import InputOutputModel, Plant
from residua.progress import Progress, progress_of
from residua.shown import Shown
from residua.visible import echo
from residua.words import counted

PastOf = Literal["auto", "own", "all"]
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
        True where it has the past of the other outputs too.
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
        return order_table(
            {
                "order": [str(order) for order in near],
                "information criterion": [f"{values[k]:.1f}" if np.isfinite(values[k]) else "-" for k in near],
                "held-out error": [share(float(self.choice.held_out_errors[kind, k])) for k in near],
            }
        )


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class EquationReport(Shown, FitReport):
    """Report on the equations of a model: their orders, coefficients and fit.

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
        return "\n".join([*lines, "", *self.fit_lines()])


@dataclass(frozen=True, eq=False, repr=False)
class ArxModel(RecordedModel):
    """Linear equations from recordings, one for each output, with their report and uncertainty.

    Attributes
    ----------
    model : InputOutputModel
        The equations, for parity relations; ``with_sensor_faults()`` and the like add faults.
    plant : Plant
        The same in state space, with the equation errors as its noise, in innovation form: a state for each row of the
        past of each equation, and for each row of delay.
    report : EquationReport
        ``print(model.report)`` shows it; its ``equations`` have the coefficients with their covariance.
    innovation_covariance : ndarray, shape (outputs, outputs)
        Of the equation errors.
    basis : Equations
        The fit of the coefficients, in units of its own.
    """

    model: InputOutputModel
    plant: Plant
    report: EquationReport
    innovation_covariance: NDArray[np.float64]
    basis: Equations = field(repr=False)

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Covariance of the coefficients of all equations, in the order of ``report.equations`` and their terms.

        In the units of the channels, shape (coefficients, coefficients).
        """
        size = np.concatenate(self.basis.scale())
        return self.basis.covariance * np.outer(size, size)

    def _directions(self, most: int) -> tuple[NDArray[np.float64], list[dict[str, NDArray[np.float64]]]]:
        """Return the leading directions of the covariance of the coefficients."""
        return self.basis.directions(most)

    def _predicted(self, Z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the predictions of the equations."""
        equations, channels = self.report.equations, self.plant.inputs + self.plant.outputs
        past = max((row for one in equations for _, row in one.terms), default=0)
        out = np.full((len(Z), len(equations)), np.nan)
        if len(Z) > past:
            out[past:] = 0.0
            for i, one in enumerate(equations):
                for (name, row), value in zip(one.terms, one.coefficients, strict=True):
                    out[past:, i] += value * Z[past - row : len(Z) - row, channels.index(name)]
        return out

    def __repr__(self) -> str:
        orders = ", ".join(str(one.order) for one in self.report.equations)
        return f"ArxModel(orders {orders}, {self.plant!r})"


def arx(
    recordings: Any,
    y: ArrayLike | None = None,
    *,
    inputs: Names = None,
    outputs: Names = None,
    dt: float | None = None,
    order: int | Mapping[str, int] | Literal["auto"] = "auto",
    max_order: int | None = None,
    past_of: PastOf = "auto",
    feedthrough: bool = False,
    delays: Mapping[str, int] | None = None,
    held_out: float = 0.25,
    units: Mapping[str, str] | None = None,
    name: str = "identified",
    progress: Progress | bool | None = None,
) -> ArxModel:
    r"""Identify one linear equation for each output from fault-free recordings, by least squares.

    .. math::

       y_{i,k} = \sum_{l=1}^{n_i} \left( a_{i,l}^T\, y_{k-l} + b_{i,l}^T\, u_{k-l} \right) + c_i + e_{i,k}

    with white equation errors ``e``; with ``feedthrough`` also :math:`b_{i,0}^T u_k`. Each equation has the past of
    its own output, or of all of them, and the inputs. What comes out is a :class:`residua.InputOutputModel`, whose
    equations are parity relations as they stand (:func:`residua.design.primary_residuals`,
    :func:`residua.design.structured_parity`), and the same as a plant in innovation form.

    Guaranteed: the least-squares solution of the stacked regression over all windows that no missing value cuts. The
    same bits when a channel has other units, as far as these differ by a power of two.

    Parameters
    ----------
    recordings : Recording, data frame, path, array, pair (u, y), or a list of these
        Fault-free. A missing value cuts a recording in two; nothing is interpolated, and nothing counts across a
        cut. Several recordings share one operating point. An array alone holds the inputs, then the outputs; with
        ``y`` it holds the inputs (``None`` for none).
    y : array_like, shape (time, outputs), optional
    inputs, outputs : sequence of str, optional
        The channels by name. When omitted: of a recording or data frame no inputs, and every other column is an output.
    dt : float, optional
        Step in seconds; that of the recordings when omitted.
    order : int, mapping of str to int, or "auto"
        ``n``, of all equations or by output; by Schwarz's criterion, for each output by itself, when omitted. The
        report shows it beside the error on the held-out part.
    max_order : int, optional
        The largest order that is compared; 20, or what the data support, when omitted.
    past_of : {"auto", "own", "all"}
        ``"own"``: each equation has the past of its own output alone, so that a fault of a sensor moves its own
        residual and no other. ``"all"``: that of all outputs, which predicts better where outputs share what drives
        them. ``"auto"`` takes for each output what Schwarz's criterion prefers, and says by how much.
    feedthrough : bool
        True if an input moves an output within the same row. A controller that answers within the row looks the same,
        so that this is never guessed; the report says where the data look so.
    delays : mapping of str to int, optional
        Rows by which an input acts late, where that is known.
    held_out : float
        The last part of each recording, as a fraction, on which the model is judged; none of it is used for the model.
    units : mapping of str to str, optional
        Of the channels, for plots and tables.
    name : str
        Of the model and the plant.
    progress : callable, bool, optional
        Is called with (stage, done, total); a bar on a terminal when omitted.

    Returns
    -------
    ArxModel
        ``model`` goes on to parity relations, ``plant`` to any design; ``report`` says how good they are.

    Raises
    ------
    DataError
        If a channel is missing, constant, or a linear function of others; if nearer signals of an equation determine a
        further one (the order is too large, or the inputs do not move freely); or there are too few complete rows in
        a row.
    SettingError
        If an option is none of its values.

    See Also
    --------
    subspace : One state-space model for all outputs; fewer parameters where outputs share their dynamics.
    parity_from_data : Relations without a model.

    Notes
    -----
    Assumes: the equation errors are white. Noise of sensors is not: it enters the regressors too, biases the
    coefficients of low orders towards smaller dynamics, and asks for a high order; :func:`subspace` then needs fewer
    parameters. The report calls such errors coloured, and its standard errors are then too small. In closed loop the
    estimate holds if the controller acts a row later and the errors are white.

    The standard errors are those of least squares with white errors, the covariance between equations included.

    References
    ----------
    Ljung (1999), System Identification, 2nd edition, sections 4.2, 10.1 (least squares) and 9.4 (covariance); Gertler
    (1991), section 3.2 (the equations as primary residuals).

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> rng = np.random.default_rng(0)
    >>> u, e = rng.standard_normal((2000, 1)), 0.1 * rng.standard_normal(2000)
    >>> y = np.zeros(2000)
    >>> for k in range(1, 2000):
    ...     y[k] = 0.9 * y[k - 1] + 0.5 * u[k - 1, 0] + e[k]
    >>> model = rs.identify.arx(u, y + 20, inputs=["valve"], outputs=["level"])
    >>> print(model.report.equations[0])
    level[k] = 0.4986 (± 0.0026) valve[k-1] + 0.8982 (± 0.0022) level[k-1] + e
    >>> flt = rs.design.primary_residuals(model.model.with_sensor_faults())
    >>> monitor = rs.Monitor(flt).fit(u, y + 20)
    """
    if past_of not in get_args(PastOf):
        raise SettingError(f"past_of must be one of {', '.join(get_args(PastOf))}, got {echo(past_of)}")
    if max_order is not None:
        checked_count(max_order, "max_order")
    gathered = gather(recordings, y, inputs=inputs, outputs=outputs, dt=dt)
    orders = order if isinstance(order, Mapping) else dict.fromkeys(gathered.outputs, order)
    orders = {} if isinstance(order, str) and order == "auto" else orders
    try:
        named = [gathered.outputs[index_of(output, gathered.outputs, "output")] for output in orders]
    except ModelError as error:
        raise SettingError(f"order: {error}") from error
    other = "'auto' or a mapping of outputs to their orders, such as {'level': 2, 'flow': 1}"
    wanted = {k: checked_count(n, "order", 0, other) for k, n in zip(named, orders.values(), strict=True)}
    first, last = gathered.delayed(delays or {}).divided(held_out)
    facts = channel_facts(first)
    facts.check()
    tell, close = progress_of(progress)
    try:
        most = max(most_orders(first) if max_order is None else max_order, *(wanted or {"": 0}).values())
        factor = hankel_factor(first, most + 1, facts, progress=tell)
        choices = choose_equations(factor, last, wanted or "auto", past_of, feedthrough=feedthrough)
        longest = max(one.shape.order for one in choices)
        factor = factor if longest == most else hankel_factor(first, longest + 1, facts, progress=tell)
        shapes = [one.shape for one in choices]
        basis = fit_equations(factor, shapes, first, facts, dict(delays or {}), feedthrough=feedthrough)
    finally:
        close()
    plant, V = basis.plant(units=units, name=name)
    equations, channels, m = [], basis.inputs + basis.outputs, len(basis.inputs)
    for i, (one, size, choice) in enumerate(zip(basis.each, basis.scale(), choices, strict=True)):
        variance, inverse = basis.error_covariance[i, i], one.inverse[1:]
        C = variance * (inverse @ inverse.T) * np.outer(size, size)
        terms = tuple((channels[c], row + basis.delays.get(channels[c], 0)) for c, row in one.terms)
        error, errors = float(np.sqrt(variance) * basis.units[m + i]), np.sqrt(np.diag(C))
        kind = (basis.outputs[i], one.shape.order, one.shape.coupled)
        equations.append(Equation(*kind, terms, one.values * size, errors, C, error, choice))
    report = EquationReport(
        **facts_of_fit(basis.innovations(), first, last, facts, factor, feedthrough=feedthrough),
        method="ARX",
        steady_gain=basis.steady_gain(),
        equations=tuple(equations),
    )
    report = replace(report, notes=(*gathered.notes, *facts.notes(gathered), *report.notes))
    model = basis.model(name=name, units=units, plant=plant)
    return ArxModel(model, plant.with_identification(report.identification), report, V, basis)
