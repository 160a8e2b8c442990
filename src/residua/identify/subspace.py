"""A state-space model with its noise from recordings, by subspace identification."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from residua.errors import DataError, SettingError
from residua.identify.canonical_weights import canonical_weights
from residua.identify.channel_facts import ChannelFacts, channel_facts
from residua.identify.excitation import Excitation, excitation
from residua.identify.fit_report import SteadyGain
from residua.identify.hankel_factor import HankelFactor, hankel_factor
from residua.identify.horizon import choose_past, past_of_order
from residua.identify.identified_model import IdentifiedModel, plant_of, with_input_delays
from residua.identify.model_report import IdentificationReport
from residua.identify.moesp import moesp
from residua.identify.n4sid import n4sid
from residua.identify.order_choice import OrderChoice, choose_order
from residua.identify.pbsid import pbsid
from residua.identify.prediction import error_facts
from residua.identify.realisation import Innovations, realise, resampled
from residua.identify.segments import Gathered, Names, checked_count, gather
from residua.identify.state_map import StateMap
from residua.linear.poles.spectrum import spectral_radius
from residua.plant import Plant
from residua.progress import Progress, progress_of
from residua.tolerances import POLE, RANK
from residua.visible import echo
from residua.words import counted, number

Method = Literal["pbsid", "cva", "n4sid", "moesp"]
#: The names of the methods in texts.
_WRITTEN = {"pbsid": "PBSID", "cva": "CVA", "n4sid": "N4SID", "moesp": "MOESP"}
#: Orders that are compared at most, unless the caller says otherwise.
_MOST_ORDERS = 25
#: Rows on which a model is judged at most, of its own and of those that are held out.
_JUDGED = 500_000
#: A spread is estimated from at least so many parts of the data.
_LEAST_PARTS = 6
#: Time constants of the slowest pole that a stretch of rows has to last for a steady gain.
_SETTLED_IN = 5.0
#: The part of their size by which states may move in a row at the operating point without a word.
_UNBALANCED = 0.01


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
        Whether an input moves an output within the same row. A controller that answers within the row looks the same,
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
    _check_numbers(order, max_order, past, held_out)
    gathered = gather(recordings, y, inputs=inputs, outputs=outputs, dt=dt)
    whole = gathered.delayed(delays or {})
    tell, close = progress_of(progress)
    try:
        first, last = whole.divided(held_out)
        if not first.segments:
            raise DataError("nothing is left to identify from: hold out less")
        facts = channel_facts(first)
        facts.check()
        horizon = choose_past(first, facts, feedthrough=feedthrough) if past == "auto" else int(past)
        if past == "auto" and order != "auto":
            horizon = past_of_order(first, int(order), horizon)
        if method == "moesp" and horizon < 2:
            if past != "auto":
                raise SettingError("past must be at least 2 for 'moesp', whose dynamics are a shift by a row, got 1")
            horizon = 2
        length = horizon + 1 if method == "pbsid" else 2 * horizon
        factor = hankel_factor(first, length, facts, progress=tell)
        states = _states(method, factor, horizon, feedthrough)
        most = len(states.T) if max_order is None else min(max_order, len(states.T))
        most = min(most, _MOST_ORDERS) if max_order is None else most
        choice = choose_order(factor, states, most, first, last, order, feedthrough=feedthrough, progress=tell)
        model = realise(factor, states, choice.order, feedthrough=feedthrough)
        made = _Made(method, first, last, facts, factor, states, choice, model, feedthrough)
        notes = (*gathered.notes, *facts.notes(gathered), *made.notes())
        return made.result(delays or {}, notes, units=units, name=name)
    finally:
        close()


def _check_numbers(order: Any, max_order: Any, past: Any, held_out: Any) -> None:
    for value, what, least, other in (
        (order, "order", 0, "auto"),
        (max_order, "max_order", 0, None),
        (past, "past", 1, "auto"),
    ):
        if not (type(value) is type(other) and value == other):
            checked_count(value, what, least, repr(other))
    if max_order is not None and order != "auto" and max_order < order:
        raise SettingError(f"max_order must be at least the order that is asked for, {order}, got {max_order}")
    if not (isinstance(held_out, (int, float, np.integer, np.floating)) and 0 <= held_out <= 0.9):
        raise SettingError(f"held_out must be a fraction from 0 to 0.9, got {echo(held_out)}")


def _states(method: str, factor: HankelFactor, past: int, feedthrough: bool) -> StateMap:
    if method == "pbsid":
        return pbsid(factor, past, past, feedthrough=feedthrough)
    return {"n4sid": n4sid, "moesp": moesp, "cva": canonical_weights}[method](factor, past)


class _Made:
    """A model with all that it was made of, for its report."""

    def __init__(
        self,
        method: str,
        first: Gathered,
        last: Gathered,
        facts: ChannelFacts,
        factor: HankelFactor,
        states: StateMap,
        choice: OrderChoice,
        model: Innovations,
        feedthrough: bool,
    ) -> None:
        self.method, self.first, self.last, self.facts, self.factor = method, first, last, facts, factor
        self.states, self.choice, self.model, self.feedthrough = states, choice, model, feedthrough
        self.excitation = excitation(factor, states.past, feedthrough=feedthrough)

    def notes(self) -> tuple[str, ...]:
        """Return what is said of the model itself."""
        first, model = self.first, self.model
        notes = [model.note] if model.note else []
        if not self.feedthrough:
            pairs = [f"{first.outputs[i]!r} with {first.inputs[j]!r}" for i, j in self.excitation.instant]
            if pairs:
                notes.append(
                    f"within a row {', '.join(pairs[:4])} move together: feedthrough=True if the plant answers within "
                    "a row; leave it if a controller does"
                )
        if not model.order:
            notes.append("the model has no states: nothing of the past, and no input, tells what the outputs will be")
        rows = max((len(one) for one in self.last.segments), default=0)
        if self.last.n_samples and rows <= model.past:
            notes.append(
                f"nothing is judged on held-out rows: {rows} in a row, and a prediction needs {model.past} before it"
            )
        radius = float(spectral_radius(model.A))
        if radius >= 1:
            notes.append(
                f"the plant has a pole of size {radius:.6g}: it integrates, drifts, or was held by a controller"
            )
        slowest = float(np.abs(np.linalg.eigvals(model.A) - 1).min(initial=np.inf))
        longest = max(len(one) for one in first.segments)
        if first.inputs and slowest >= POLE and longest * slowest < _SETTLED_IN:
            notes.append(
                f"a pole lies near one, with a time constant of {number(first.dt / slowest)} s, and the longest "
                f"stretch without a gap has {number(longest * first.dt)} s: the steady gains, and their standard "
                "errors, are from transients alone and say little"
            )
        left = model.at_rest()[2]
        if left > _UNBALANCED:
            notes.append(f"no operating point balances the model: its states move by {left:.2g} a row at mean inputs")
        return tuple(notes)

    def result(self, delays: Mapping[str, int], notes: tuple[str, ...], **options: Any) -> IdentifiedModel:
        """Return the model as users get it."""
        first, facts, model = self.first, self.facts, self.model
        around = (first.inputs, first.outputs, first.dt, facts.mean, facts.units)
        plant, K, V = plant_of(model, *around, **options)
        others: list[Plant] = []
        count = len(self.factor.parts)
        if count < _LEAST_PARTS:
            notes += (
                f"no standard errors: the rows make {counted(count, 'part')} of data, {_LEAST_PARTS} are needed; "
                "identify from more rows, or with a shorter past",
            )
        else:

            def find(factor: HankelFactor) -> StateMap:
                return _states(self.method, factor, self.states.past, self.feedthrough)

            parts = resampled(self.factor, self.states, model.order, find, feedthrough=self.feedthrough)
            others = [plant_of(one, *around)[0] for one in parts]
            if len(others) < count:
                notes += (
                    f"standard errors are from {len(others)} of {count} parts of the data: without one of the others "
                    f"no stable model of order {model.order} can be made, so that they are too small, if anything",
                )
        fitted = error_facts(model, first.shortened(_JUDGED, 2 * model.past + 1), facts.mean, facts.units)
        assert fitted is not None  # there are windows longer than the past
        report = IdentificationReport(
            method=_WRITTEN[self.method],
            inputs=first.inputs,
            outputs=first.outputs,
            dt=first.dt,
            order=model.order,
            order_reason=self.choice.reason,
            singular_values=self.states.singular_values,
            orders=self.choice.orders,
            criterion=self.choice.criterion,
            held_out_errors=self.choice.held_out_errors,
            past=self.states.past,
            samples=first.n_samples,
            held_out=error_facts(model, self.last.shortened(_JUDGED, 2 * model.past + 1), facts.mean, facts.units),
            fitted=fitted,
            excitation=self.excitation,
            poles=np.linalg.eigvals(model.A).astype(complex),
            predictor_poles=np.linalg.eigvals(model.A - model.K @ model.C).astype(complex),
            steady_gain=_steady_gain(plant, others, self.excitation),
            notes=notes,
        )
        delayed = [with_input_delays(one, delays) for one in (plant, *others)]
        rows = delayed[0].n_states - plant.n_states
        noted = delayed[0].with_identification(report.identification)
        return IdentifiedModel(noted, report, np.vstack([K, np.zeros((rows, len(V)))]), V, tuple(delayed[1:]))


def _steady_gain(plant: Plant, others: list[Plant], excitation: Excitation) -> SteadyGain | None:
    poles = np.linalg.eigvals(plant.A)
    if not plant.inputs or (len(poles) and np.abs(poles - 1).min() < POLE):
        return None
    gains = np.array([one.system("control").dc_gain() for one in others])
    count = len(gains)
    error = np.sqrt((count - 1) / count * ((gains - gains.mean(axis=0)) ** 2).sum(axis=0)) if count else None
    if error is not None:
        error[:, excitation.unexplained < RANK] = np.inf  # all parts may agree on what no row of any of them shows
    return SteadyGain(plant.system("control").dc_gain(), error)
