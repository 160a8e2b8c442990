"""A state-space model with its noise from recordings, by subspace identification."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import DataError, SettingError
from residua.identify.channel_facts import ChannelFacts, channel_facts
from residua.identify.fit_report import IdentificationReport, SteadyGain, facts_of_fit
from residua.identify.hankel_factor import NOISE_FREE, HankelFactor, count_windows, hankel_factor
from residua.identify.identified_model import IdentifiedModel, plant_of, with_input_delays
from residua.identify.prediction import Innovations, predictions
from residua.identify.segments import Gathered, Names, checked_count, gather
from residua.identify.subspace_methods import StateMap, realise, resampled, state_map
from residua.progress import Progress, progress_of
from residua.tolerances import POLE, RANK
from residua.visible import echo
from residua.words import counted, number

Method = Literal["pbsid", "cva", "n4sid", "moesp"]
#: Orders that are compared at most, unless the caller says otherwise.
_MOST_ORDERS = 25
#: A spread is estimated from at least so many parts of the data.
_LEAST_PARTS = 6
#: Time constants of the slowest pole that a stretch of rows has to last for a steady gain.
_SETTLED_IN = 5.0
#: Rows from which the past is chosen: that choice need not be exact.
_ROWS_FOR_PAST = 100_000
#: Columns of the Hankel matrix of the longest past that is tried, and rows for each of its columns.
_MOST_COLUMNS, _LEAST_ROWS = 400, 4
#: The longest past that is tried.
_LONGEST = 60
#: Rows on which orders are compared, of those that the model is from and of those held out.
_ROWS = 50_000
#: Orders below one that is asked for that it is compared with, where it is larger than those that are compared anyway.
_BELOW = 3


def choose_past(
    gathered: Gathered, facts: ChannelFacts, order: int | Literal["auto"], least: int, *, feedthrough: bool
) -> int:
    """Return the rows of the past that predict the outputs best by Akaike's criterion, corrected for few samples.

    They are as many as the order that is wanted needs, and ``least`` at least.

    Raises
    ------
    DataError
        If the data are too few for a single row of the past.
    """
    data = gathered.shortened(_ROWS_FOR_PAST)
    n = len(gathered.channels)
    most = min(_LONGEST, _MOST_COLUMNS // n)
    while most > 1 and count_windows(data, most + 1) < _LEAST_ROWS * (1 + n * (most + 1)):
        most -= 1
    windows = count_windows(data, most + 1)
    if windows < 2 * (1 + 2 * n):
        rows = max((len(one) for one in data.segments), default=0)
        raise DataError(
            f"too few data for a model of {n} channels: the longest segment without a missing value has {rows} rows, "
            f"{2 * (1 + 2 * n) + 1} in a row are the least; take fewer channels, or a longer recording"
        )
    factor = hankel_factor(data, most + 1, facts)
    newest_first = [column for time in reversed(range(most)) for column in factor.signals([time])]
    fixed = [0, *(factor.inputs(most) if feedthrough else [])]
    T = np.asarray(np.linalg.qr(factor.R[:, [*fixed, *newest_first, *factor.outputs(most)]], mode="r"))
    outputs = len(gathered.outputs)

    def akaike(past: int) -> float:
        regressors = len(fixed) + past * n
        left = windows - regressors - outputs - 1
        if left <= 0:
            return np.inf
        return windows * log_determinant(T[regressors:, -outputs:], windows) + 2 * outputs * regressors * windows / left

    best = min(range(1, most + 1), key=akaike)
    return max(best if order == "auto" else past_of_order(gathered, int(order), best), least)


def past_of_order(gathered: Gathered, order: int, least: int) -> int:
    """Return the rows of the past, ``least`` or more, in which so many states show, and one more for their shift.

    Where the data are too few for the one more, and the least will do without it, it is the least.

    Raises
    ------
    DataError
        If the data have fewer than four windows for each column of that Hankel matrix.
    """
    n, p = len(gathered.channels), len(gathered.outputs)

    def enough(past: int) -> int:
        return _LEAST_ROWS * (1 + n * (past + 1))

    past = max(-(-order // p) + 1, least)
    windows = count_windows(gathered, past + 1)
    if windows >= enough(past):
        return past
    if order <= least * p:
        return least
    smaller = ((k, -(-k // p) + 1) for k in range(order - 1, least * p, -1))
    largest = next((k for k, rows in smaller if count_windows(gathered, rows + 1) >= enough(rows)), least * p)
    raise DataError(
        f"too few data for a model of order {order}: it needs {past} rows of the past of "
        f"{counted(n, 'channel')}, and there are {windows} such windows where {enough(past)} are the "
        f"least; the data are enough for order {largest}; choose a smaller order, or give the past yourself"
    )


def log_determinant(residual: NDArray, samples: int) -> float:
    """Return the logarithm of the determinant of a covariance, from columns whose products over ``samples`` it is."""
    s = np.linalg.svd(residual, compute_uv=False) / np.sqrt(samples)
    return 2 * float(np.log(np.maximum(s, NOISE_FREE)).sum())


def subspace(
    recordings: Any,
    y: ArrayLike | None = None,
    *,
    inputs: Names = None,
    outputs: Names = None,
    dt: float | None = None,
    method: Method = "pbsid",
    order: int | Literal["auto"] = "auto",
    max_order: int | None = None,
    past: int | Literal["auto"] = "auto",
    feedthrough: bool = False,
    delays: Mapping[str, int] | None = None,
    held_out: float = 0.25,
    units: Mapping[str, str] | None = None,
    name: str = "identified",
    progress: Progress | bool | None = None,
) -> IdentifiedModel:
    r"""Identify a plant with its noise from fault-free recordings.

    The model is in innovation form,

    .. math:: x_{k+1} = A x_k + B u_k + K e_k, \qquad y_k = C x_k + D u_k + e_k,

    with white innovations ``e`` of covariance ``V``. States are combinations of ``past`` rows of inputs and outputs,
    chosen by a singular value decomposition; the matrices, the gain and the covariance follow by regression from the
    triangular factor of one Hankel matrix, which is built block by block: memory does not grow with the rows. The
    predictor, ``A - K C``, is always stable.

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
    method : {"pbsid", "cva", "n4sid", "moesp"}
        ``"pbsid"`` is right in closed loop too. The others need inputs that do not depend on past outputs.
    order : int or "auto"
        States; by Schwarz's criterion when omitted. The report shows it beside the singular values and the error on the
        held-out part.
    max_order : int, optional
        The largest order that is compared; 25, or what the data support, when omitted.
    past : int or "auto"
        Rows of the past; by Akaike's criterion for autoregressions with inputs when omitted.
    feedthrough : bool
        True if an input moves an output within the same row. A controller that answers within the row looks the same,
        so that this is never guessed; the report says where the data look so.
    delays : mapping of str to int, optional
        Rows by which an input acts late, where that is known: the plant holds them as states.
    held_out : float
        The last part of each recording, as a fraction, on which the model is judged; none of it is used for the model.
    units : mapping of str to str, optional
        Of the channels, for plots and tables.
    name : str
        Of the plant.
    progress : callable, bool, optional
        Is called with (stage, done, total); a bar on a terminal when omitted.

    Returns
    -------
    IdentifiedModel
        ``plant`` goes through any analysis and design; ``report`` says how good it is.

    Raises
    ------
    DataError
        If a channel is missing, constant, or a linear function of others; if there are too few complete rows in a
        row; or no stable predictor exists for the data.
    SettingError
        If an option is none of its values.

    See Also
    --------
    residua.design.kalman_filter : The residuals of an identified plant: its innovations.

    Notes
    -----
    Assumes: the plant is linear, time-invariant and fault-free around one operating point, and the inputs move enough:
    what they do not excite the data cannot say, and the standard errors of the steady gains in the report show it.
    The threshold of a monitor should be fitted on other rows than the model, or the model's own held-out check be read.

    References
    ----------
    Chiuso (2007), Automatica 43(6); Van Overschee and De Moor (1995), Automatica 31(12); Larimore (1990), 29th CDC;
    Verhaegen (1994), Automatica 30(1).

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal((3000, 1))
    >>> tank = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1)
    >>> y = 20.0 + tank.system("control").simulate(u) + 0.05 * rng.standard_normal((3000, 1))
    >>> model = rs.identify.subspace(u, y, inputs=["valve"], outputs=["level"], dt=1.0)
    >>> model.report.order, model.plant.system("control").poles().real.round(2)
    (1, array([0.9]))
    >>> monitor = rs.Monitor(rs.design.kalman_filter(model.plant.with_sensor_faults()))
    """
    if method not in get_args(Method):
        raise SettingError(f"method must be one of {', '.join(get_args(Method))}, got {echo(method)}")
    options = {"order": (order, 0, "auto"), "max_order": (max_order, 0, None), "past": (past, 1, "auto")}
    for what, (value, smallest, other) in options.items():
        if not (type(value) is type(other) and value == other):
            checked_count(value, what, smallest, repr(other))
    if max_order is not None and order != "auto" and max_order < order:
        raise SettingError(f"max_order must be at least the order that is asked for, {order}, got {max_order}")
    least = 2 if method == "moesp" else 1
    if past != "auto" and past < least:
        raise SettingError("past must be at least 2 for 'moesp', whose dynamics are a shift by a row, got 1")
    gathered = gather(recordings, y, inputs=inputs, outputs=outputs, dt=dt)
    delayed = dict(delays or {})
    first, last = gathered.delayed(delayed).divided(held_out)
    facts = channel_facts(first)
    facts.check()
    tell, close = progress_of(progress)
    try:
        horizon = choose_past(first, facts, order, least, feedthrough=feedthrough) if past == "auto" else int(past)
        length = horizon + 1 if method == "pbsid" else 2 * horizon
        factor = hankel_factor(first, length, facts, progress=tell)
        states = state_map(method, factor, horizon, feedthrough=feedthrough)
        most = min(_MOST_ORDERS if max_order is None else max_order, len(states.T))
        choice = choose_order(factor, states, most, first, last, order, feedthrough=feedthrough, progress=tell)
        model = realise(factor, states, choice["order"], feedthrough=feedthrough)
        facts_of_model = facts_of_fit(model, first, last, facts, factor, feedthrough=feedthrough)
        parts = len(factor.parts)
        again = resampled(factor, states, model.order, method, feedthrough=feedthrough) if parts >= _LEAST_PARTS else []
    finally:
        close()
    around = (first.inputs, first.outputs, first.dt, facts.mean, facts.units)
    plant, K, V = plant_of(model, *around, units=units, name=name)
    others = [plant_of(one, *around)[0] for one in again]
    gain = None
    if plant.inputs and np.abs(facts_of_model["poles"] - 1).min(initial=np.inf) >= POLE:
        gains = np.array([one.system("control").dc_gain() for one in others])
        error = np.sqrt((len(gains) - 1) * gains.var(axis=0)) if len(gains) else None
        if error is not None:
            # all parts may agree on what no row of any of them shows
            error[:, facts_of_model["excitation"].unexplained < RANK] = np.inf
        gain = SteadyGain(plant.system("control").dc_gain(), error)
    report = IdentificationReport(
        **facts_of_model,
        **choice,
        method=method.upper(),
        singular_values=states.singular_values,
        predictor_poles=np.linalg.eigvals(model.A - model.K @ model.C).astype(complex),
        steady_gain=gain,
    )
    about = _about_the_model(report, max(map(len, first.segments)), len(others), parts)
    report = replace(report, notes=(*gathered.notes, *facts.notes(gathered), *report.notes, *about))
    late, *others = (with_input_delays(one, delayed) for one in (plant, *others))
    K = np.vstack([K, np.zeros((late.n_states - plant.n_states, len(V)))])
    return IdentifiedModel(late.with_identification(report.identification), report, K, V, tuple(others))


def _about_the_model(report: IdentificationReport, longest: int, others: int, parts: int) -> list[str]:
    """Return notes on the model, and on its standard errors from the data without each of their parts."""
    notes, dt = [], report.dt
    if not report.order:
        notes.append("the model has no states: nothing of the past, and no input, tells what the outputs will be")
    slowest = float(np.abs(report.poles - 1).min(initial=np.inf))
    if report.inputs and slowest >= POLE and longest * slowest < _SETTLED_IN:
        notes.append(
            f"a pole lies near one, with a time constant of {number(dt / slowest)} s, and the longest stretch without "
            f"a gap has {number(longest * dt)} s: the steady gains, and their standard errors, are from transients "
            "alone and say little"
        )
    if parts < _LEAST_PARTS:
        notes.append(
            f"no standard errors: the rows make {counted(parts, 'part')} of data, {_LEAST_PARTS} are needed; identify "
            "from more rows, or with a shorter past"
        )
    elif others < parts:
        notes.append(
            f"standard errors are from {others} of {parts} parts of the data: without one of the others no stable "
            f"model of order {report.order} can be made, so that they are too small, if anything"
        )
    return notes


def choose_order(
    factor: HankelFactor,
    states: StateMap,
    most: int,
    fitted: Gathered,
    held_out: Gathered,
    wanted: int | Literal["auto"],
    *,
    feedthrough: bool,
    progress: Progress,
) -> dict[str, Any]:
    """Return the order by Schwarz's criterion, or the one that is wanted, beside the others, as the report has them.

    Raises
    ------
    DataError
        If the data have fewer candidates for states than the order that is wanted.
    """
    orders = tuple(range(most + 1))
    if wanted != "auto":
        orders = tuple(sorted({*orders, *range(max(int(wanted) - _BELOW, 0), int(wanted) + 1)}))
    if orders[-1] > len(states.T):
        raise DataError(
            f"the data support {len(states.T)} states at most with {states.past} rows of the past, {orders[-1]} are "
            "asked for: give a longer past, or a smaller order"
        )
    enough = 2 * states.past + 1  # rows of a part: fewer than the past foretell none
    seen, unseen = fitted.shortened(_ROWS, enough), held_out.shortened(_ROWS, enough)
    values, errors = np.full(len(orders), np.inf), np.full(len(orders), np.nan)
    for k, order in enumerate(orders):
        progress("orders", k, len(orders))
        try:
            model = realise(factor, states, order, feedthrough=feedthrough)
        except DataError:  # no stable predictor has its covariances
            continue
        values[k] = criterion(model, seen, factor, feedthrough=feedthrough)
        rows, total, squares, left = 0, 0.0, 0.0, 0.0
        for _, y, predicted in predictions(model, unseen, factor.reference, factor.units):
            e, rows, total = y - predicted, rows + len(y), total + y.sum(axis=0)
            squares, left = squares + np.einsum("ij,ij->j", y, y), left + np.einsum("ij,ij->j", e, e)
        if rows:
            spread = np.asarray(squares - total**2 / rows)
            share = np.maximum(left / np.where(spread > 0, spread, 1.0), np.finfo(float).tiny)
            errors[k] = np.exp(np.log(share).mean() / 2)
    progress("orders", len(orders), len(orders))
    values -= values.min()
    best, reason = int(values.argmin()) if wanted == "auto" else int(wanted), "as asked for"
    if wanted == "auto":
        reason = "the smallest information criterion"
        if best == most and best:
            reason += ", which is still falling at the largest order that was compared (max_order)"
        if np.isfinite(errors).any():
            reason += f"; the held-out error is smallest at order {int(np.nanargmin(errors))}"
    compared = {"orders": orders, "criterion": values, "held_out_errors": errors}
    return {"order": best, "order_reason": reason, **compared}


def criterion(model: Innovations, fitted: Gathered, factor: HankelFactor, *, feedthrough: bool) -> float:
    r"""Return Schwarz's criterion of a model, by the errors of its own predictor on rows that it is from.

    .. math:: N \log \det \hat V_n + n (2 p + m) \log N

    The predictor runs on from row to row. Errors of the outputs given states that are taken anew from the past of each
    row would not do: the leading combination of the past alone says nearly all of the next row of a slow output, and
    nothing of the row after.
    """
    errors = np.vstack(
        [y - predicted for _, y, predicted in predictions(model, fitted, factor.reference, factor.units)]
    )
    (rows, p), m = errors.shape, factor.n_inputs
    parameters = model.order * (2 * p + m) + (p * m if feedthrough else 0)
    root = np.asarray(np.linalg.qr(errors, mode="r"))
    return rows * log_determinant(root, rows) + parameters * float(np.log(rows))
