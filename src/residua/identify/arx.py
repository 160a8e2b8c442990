"""One linear equation for each output from recordings, by least squares (ARX)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from residua.arrays import index_of
from residua.errors import DataError, ModelError, SettingError
from residua.identify.arx_model import ArxModel, Basis, steady_gain
from residua.identify.arx_orders import EquationChoice, choose_equations, most_orders
from residua.identify.arx_report import Equation, EquationReport
from residua.identify.channel_facts import channel_facts
from residua.identify.equations import Equations, fit_equations
from residua.identify.excitation import excitation
from residua.identify.hankel_factor import hankel_factor
from residua.identify.prediction import error_facts
from residua.identify.segments import Gathered, Names, checked_count, gather
from residua.linear.poles.spectrum import spectral_radius
from residua.progress import Progress, progress_of
from residua.visible import echo

PastOf = Literal["auto", "own", "all"]
#: Rows on which a model is judged at most, of its own and of those that are held out.
_JUDGED = 500_000
#: The part of their size by which states may move in a row at the operating point without a word.
_UNBALANCED = 0.01


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
        Whether an input moves an output within the same row. A controller that answers within the row looks the same,
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
    _check_options(order, max_order, past_of, held_out)
    gathered = gather(recordings, y, inputs=inputs, outputs=outputs, dt=dt)
    wanted = _wanted(order, gathered)
    delayed = dict(delays or {})
    whole = gathered.delayed(delayed)
    tell, close = progress_of(progress)
    try:
        first, last = whole.divided(held_out)
        if not first.segments:
            raise DataError("nothing is left to identify from: hold out less")
        facts = channel_facts(first)
        facts.check()
        most = max(most_orders(first) if max_order is None else max_order, *(wanted or {"": 0}).values())
        factor = hankel_factor(first, most + 1, facts, progress=tell)
        choices = choose_equations(factor, last, wanted or "auto", past_of, feedthrough=feedthrough)
        longest = max(one.shape.order for one in choices)
        factor = factor if longest == most else hankel_factor(first, longest + 1, facts, progress=tell)
        equations = fit_equations(factor, [one.shape for one in choices], first.channels, feedthrough=feedthrough)
    finally:
        close()
    basis = Basis(equations, first.inputs, first.outputs, first.dt, facts.mean, facts.units, delayed)
    plant, V = basis.plant(equations, units=units, name=name)
    innovations = equations.innovations()
    fitted = error_facts(innovations, first.shortened(_JUDGED, 2 * longest + 1), facts.mean, facts.units)
    assert fitted is not None  # there are windows longer than the past
    excited = excitation(factor, longest, feedthrough=feedthrough)
    notes = [*gathered.notes, *facts.notes(gathered)]
    if not feedthrough:
        pairs = [f"{first.outputs[i]!r} with {first.inputs[j]!r}" for i, j in excited.instant]
        if pairs:
            notes.append(
                f"within a row {', '.join(pairs[:4])} move together: feedthrough=True if the plant answers within a "
                "row; leave it if a controller does"
            )
    report = EquationReport(
        method="ARX",
        inputs=first.inputs,
        outputs=first.outputs,
        dt=first.dt,
        past=longest,
        samples=first.n_samples,
        held_out=error_facts(innovations, last.shortened(_JUDGED, 2 * longest + 1), facts.mean, facts.units),
        fitted=fitted,
        excitation=excited,
        poles=np.linalg.eigvals(innovations.A).astype(complex),
        steady_gain=steady_gain(basis),
        notes=(*notes, *_about_the_model(equations, last)),
        equations=_in_own_units(basis, choices),
    )
    model = basis.model(name=name, units=units, plant=plant)
    noted = plant.with_identification(report.identification)
    return ArxModel(model, noted, report, V, basis)


def _check_options(order: Any, max_order: Any, past_of: Any, held_out: Any) -> None:
    if past_of not in get_args(PastOf):
        raise SettingError(f"past_of must be one of {', '.join(get_args(PastOf))}, got {echo(past_of)}")
    chosen = isinstance(order, str) and order == "auto"
    if isinstance(order, (list, tuple, np.ndarray)):
        raise SettingError(
            "order must be one whole number for all outputs, 'auto', or a mapping of outputs to their orders, such as "
            f"{{'level': 2, 'flow': 1}}, got {echo(order)}"
        )
    for value in order.values() if isinstance(order, Mapping) else [] if chosen else [order]:
        checked_count(value, "order", 0, "'auto'")
    if max_order is not None:
        checked_count(max_order, "max_order")
    if not (isinstance(held_out, (int, float, np.integer, np.floating)) and 0 <= held_out <= 0.9):
        raise SettingError(f"held_out must be a fraction from 0 to 0.9, got {echo(held_out)}")


def _wanted(order: Any, gathered: Gathered) -> dict[str, int]:
    """Return the orders that are asked for, by output; those left out are chosen."""
    if isinstance(order, str):
        return {}
    if not isinstance(order, Mapping):
        return dict.fromkeys(gathered.outputs, int(order))
    try:
        return {gathered.outputs[index_of(name, gathered.outputs, "output")]: int(n) for name, n in order.items()}
    except ModelError as error:
        raise SettingError(f"order: {error}") from error


def _about_the_model(equations: Equations, last: Gathered) -> list[str]:
    """Return what is said of the model itself."""
    notes, model = [], equations.innovations()
    if last.n_samples and max((len(one) for one in last.segments), default=0) <= equations.past:
        rows = max(len(one) for one in last.segments)
        notes.append(
            f"nothing is judged on held-out rows: {rows} in a row, and a prediction needs {equations.past} before it"
        )
    radius = float(spectral_radius(model.A))
    if radius >= 1:
        notes.append(f"the plant has a pole of size {radius:.6g}: it integrates, drifts, or was held by a controller")
    left = model.at_rest()[2]
    if left > _UNBALANCED:
        notes.append(f"no operating point balances the model: its states move by {left:.2g} a row at mean inputs")
    return notes


def _in_own_units(basis: Basis, choices: tuple[EquationChoice, ...]) -> tuple[Equation, ...]:
    """Return the equations as users see them."""
    made = []
    channels, m = basis.inputs + basis.outputs, len(basis.inputs)
    for i, (one, size, choice) in enumerate(zip(basis.equations.each, basis.scale(), choices, strict=True)):
        C = basis.equations.covariance_of(i) * np.outer(size, size)
        terms = tuple((channels[c], row + basis.delays.get(channels[c], 0)) for c, row in one.terms)
        error = float(np.sqrt(basis.equations.error_covariance[i, i]) * basis.units[m + i])
        made.append(
            Equation(
                basis.outputs[i],
                one.shape.order,
                one.shape.coupled,
                terms,
                one.values * size,
                np.sqrt(np.diag(C)),
                C,
                error,
                choice,
            )
        )
    return tuple(made)
