"""Gertler's residuals that parameters of the model do not reach: a transformation that depends on the data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.decide.false_alarms import Promise, observed, promise_of
from residua.decide.fault_free import FaultFree
from residua.design.core.method import method
from residua.design.core.signals import stack_signals
from residua.errors import DataError, DesignError, SettingError
from residua.linear.poles.spectrum import spectral_radius
from residua.linear.subspaces.whitening import whitening_matrix
from residua.linear.systems.recursion import ordered_product, run_filter
from residua.plant import Plant
from residua.robust.parity.model_sensitivity import Model, checked_parameters, equations_of
from residua.robust.parity.window_filter import window_filter, window_poles
from residua.shown import Shown

#: What may be left of an expected change of a parameter, in units of the noise, is half of this.
REST = 0.1
#: Memories after which what came before is forgotten.
_FORGOTTEN = 5
#: Name of the cause that fires everything.
OTHER = "another fault"
#: A parameter of which less than this share is left beside another one cannot be distinguished from it.
_APART = 1e-6


@dataclass(frozen=True, eq=False)
class ParameterState:
    """State of a run: filter state, mean squares, their weights (a row per plant), and samples so far."""

    x: NDArray[np.float64]
    squares: NDArray[np.float64]
    weights: NDArray[np.float64]
    count: int


@dataclass(frozen=True, eq=False)
class ParameterResiduals:
    """Residuals and decisions of a block of samples.

    Attributes
    ----------
    primary : ndarray, shape (plants, time, equations)
        The primary residuals times ``scale``: in units of the noise once it is known, before that of what expected
        changes of the parameters do.
    sensitivities : ndarray, shape (plants, time, parameters, equations)
        Their derivatives, times the expected change of each parameter.
    residuals : ndarray, shape (plants, time, members, equations)
        The rest of these without the directions of the ignored parameters.
    statistic : ndarray, shape (plants, time, members)
        Their root mean square over the memory; NaN before the filter has settled.
    fired : ndarray of bool, shape (plants, time, members)
        Whether it is over the threshold; all false before thresholds are known.
    """

    primary: NDArray[np.float64]
    sensitivities: NDArray[np.float64]
    residuals: NDArray[np.float64]
    statistic: NDArray[np.float64]
    fired: NDArray[np.bool_]


def without_directions(e: NDArray[np.float64], directions: NDArray[np.float64], rest: float) -> NDArray[np.float64]:
    r"""Return :math:`(I - \Pi (\Pi^T \Pi + \epsilon^2 I)^{-1} \Pi^T)\, e` at every sample.

    With :math:`[\Pi;\, \epsilon I] = [Q_1;\, Q_2] R` the matrix taken off is :math:`Q_1 Q_1^T`: nothing is squared, and
    there is no rank to decide. Every sample is computed by itself, whatever the block that it comes in.

    Parameters
    ----------
    e : ndarray, shape (..., equations)
    directions : ndarray, shape (..., parameters, equations)
        The rows are the columns of :math:`\Pi`.
    rest : float
        :math:`\epsilon`, positive.
    """
    k, m = directions.shape[-2:]
    if not k:
        return e
    stacked = np.zeros((*directions.shape[:-2], m + k, k))
    stacked[..., :m, :] = np.swapaxes(directions, -1, -2)
    stacked[..., m:, :] = rest * np.eye(k)
    Q = np.linalg.qr(stacked)[0][..., :m, :]
    out = e
    parts = np.zeros((*e.shape[:-1], k))
    for i in range(m):  # sums in one order, whatever the block
        parts = parts + Q[..., i, :] * e[..., i, None]
    for j in range(k):
        out = out - Q[..., :, j] * parts[..., j, None]
    return out


@dataclass(frozen=True, eq=False)
class ParameterRunning:
    """Everything that running needs and that never changes."""

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]
    scale: NDArray[np.float64]
    changes: NDArray[np.float64]
    ignored: tuple[tuple[int, ...], ...]
    rest: float
    memory: int
    settle: int
    thresholds: NDArray[np.float64]

    def initial_state(self, plants: int) -> ParameterState:
        """Return the state before the first sample."""
        mean = np.zeros((plants, len(self.ignored)))
        return ParameterState(np.zeros((plants, len(self.A))), mean, mean, 0)

    def largest_gains(self) -> NDArray[np.float64]:
        """Return the sums of the sizes of the weights of each signal in each primary residual."""
        m = len(self.scale)
        gains, state = np.abs(self.D[:m]), self.B
        for _ in range(self.settle):
            gains = gains + np.abs(self.C[:m] @ state)
            state = self.A @ state
        return gains

    def block(self, state: ParameterState, data: NDArray[np.float64]) -> tuple[ParameterState, ParameterResiduals]:
        """Run over a block, shape (plants, time, inputs then outputs)."""
        plants, time, _ = data.shape
        x, v = run_filter(self.A, self.B, self.C, self.D, state.x, data)
        m, q, members = len(self.scale), len(self.changes), len(self.ignored)
        scaled = ordered_product(v.reshape(plants, time, 1 + q, m), self.scale)
        e, pi = scaled[:, :, 0], scaled[:, :, 1:] * self.changes[:, None]
        r = np.zeros((plants, time, members, m))
        for j, chosen in enumerate(self.ignored):
            r[:, :, j] = without_directions(e, pi[:, :, list(chosen)], self.rest)
        squares = np.zeros((plants, time, members))
        for i in range(m):
            squares = squares + r[..., i] ** 2
        usable = np.arange(state.count, state.count + time) >= self.settle
        weights = np.broadcast_to(usable[None, :, None].astype(float), squares.shape)
        both = np.concatenate([squares * weights, weights], axis=2)
        fade, eye = 1 - 1 / self.memory, np.eye(2 * members)
        start = np.concatenate([state.squares, state.weights], axis=1)
        # the mean after each sample is the state after it: fade times the old one plus the new square
        end, mean = run_filter(fade * eye, eye, fade * eye, eye, start, both)
        total, weight = mean[..., :members], mean[..., members:]
        degrees = np.array([max(m - len(chosen), 1) for chosen in self.ignored], dtype=float)
        with np.errstate(divide="ignore", invalid="ignore"):
            statistic = np.where(weight > 0, np.sqrt(total / weight / degrees), np.nan)
        fired = np.where(np.isnan(statistic), -np.inf, statistic) > self.thresholds
        after = ParameterState(x, end[:, :members], end[:, members:], state.count + time)
        return after, ParameterResiduals(e, pi, r, statistic, fired)


@dataclass(frozen=True, eq=False, repr=False)
class InsensitiveParity(Shown):
    r"""Residuals that each ignore some parameters, to first order, whatever the inputs do.

    Not a :class:`ResidualGenerator`: what is taken off depends on the data. It never changes; :meth:`block` maps a
    state and a block of samples to the next state and the residuals, the same for any cutting into blocks.

    Attributes
    ----------
    plant : Plant
        The nominal one.
    parameters : mapping of str to float
        Nominal values.
    changes : mapping of str to float
        The changes that are expected.
    members : tuple of str
        Names of the residuals, each a vector with one entry per equation.
    ignored : tuple of tuple of str
        The parameters that each ignores.
    causes : tuple of str
        What an alarm can name: parameters, and ``"another fault"``.
    codes : ndarray of bool, shape (members, causes)
        Which members each cause fires, as :func:`residua.decide.read_codes` takes it.
    shares : ndarray, shape (members, parameters)
        How much of the effect of each parameter is left in each member, as a share, under white inputs.
    thresholds : ndarray or None, shape (members,)
        From fault-free data, see :meth:`fit`.
    basis : str
        What the units of the residuals and the thresholds rest on.
    promised : ndarray or None, shape (members,)
        Fraction of fault-free samples over each threshold that the data of :meth:`fit` promise not to be exceeded on
        other data, with 95 % confidence; 1 if they are too few to say anything.
    """

    plant: Plant = field(repr=False)
    parameters: Mapping[str, float]
    changes: Mapping[str, float]
    members: tuple[str, ...]
    ignored: tuple[tuple[str, ...], ...]
    causes: tuple[str, ...]
    codes: NDArray[np.bool_] = field(repr=False)
    shares: NDArray[np.float64] = field(repr=False)
    running: ParameterRunning = field(repr=False)
    thresholds: NDArray[np.float64] | None
    basis: str
    promised: NDArray[np.float64] | None = None

    def initial_state(self, plants: int = 1) -> ParameterState:
        """Return the state before the first sample, of one plant or several."""
        return self.running.initial_state(plants)

    def block(
        self, state: ParameterState, u: ArrayLike | None, y: ArrayLike
    ) -> tuple[ParameterState, ParameterResiduals]:
        """Run over the next samples.

        Parameters
        ----------
        state : ParameterState
        u, y : array_like, shape (plants, time, channels)
            Deviations from the operating point.

        Returns
        -------
        state : ParameterState
            To go on with.
        residuals : ParameterResiduals
        """
        data = stack_signals(self.plant, u, y)
        if data.ndim != 3:
            raise DataError(f"a block is (plants, time, channels), got shape {data.shape}")
        if not np.isfinite(data).all():
            raise DataError("a value is missing or infinite: fill the gaps first, or begin anew after them")
        return self.running.block(state, data)

    def run(self, u: ArrayLike | None, y: ArrayLike) -> ParameterResiduals:
        """Run over a recording from its begin.

        Parameters
        ----------
        u : array_like, shape (time, inputs) or (plants, time, inputs), or None
            Deviations from the operating point.
        y : array_like, shape (time, outputs) or (plants, time, outputs)

        Returns
        -------
        ParameterResiduals
            Without the axis of the plants for a recording of one.
        """
        data = stack_signals(self.plant, u, y)
        whole = data if data.ndim == 3 else data[None]
        n_u = len(self.plant.inputs)
        _, outcome = self.block(self.initial_state(len(whole)), whole[..., :n_u] if n_u else None, whole[..., n_u:])
        if data.ndim == 3:
            return outcome
        return ParameterResiduals(*(part[0] for part in vars(outcome).values()))

    def fit(self, u: ArrayLike | None, y: ArrayLike, *, false_alarm_rate: float = 1e-4) -> InsensitiveParity:
        """Return the same with units and thresholds from fault-free data at the nominal parameters.

        The primary residuals are brought to unit covariance; then the threshold of each member is the level that its
        statistic exceeds on that fraction of samples, on data other than these: the statistic of each stretch of
        time is in units that the others give, and where the data are too few, its tail is extended and ``promised``
        says which fraction is not exceeded.

        Parameters
        ----------
        u, y : array_like
            As for :meth:`run`.
        false_alarm_rate : float
            Fraction of the samples over the threshold, of each member.

        Returns
        -------
        InsensitiveParity

        Raises
        ------
        DataError
            If there are fewer than ten samples per equation, or 30, after the filter has settled.
        """
        if not 0 < false_alarm_rate < 1:
            raise SettingError(f"false_alarm_rate must lie between 0 and 1, got {false_alarm_rate!r}")
        data = stack_signals(self.plant, u, y)
        running, promises, count = _fitted(self.running, data if data.ndim == 3 else data[None], false_alarm_rate)
        listed = "; ".join(f"{name}: {one}" for name, one in zip(self.members, promises, strict=True))
        return replace(
            self,
            running=running,
            thresholds=running.thresholds,
            promised=np.array([one.promised for one in promises]),
            basis=f"fitted to {count} fault-free samples, {promises[0] if len(promises) == 1 else listed}",
        )

    def __str__(self) -> str:
        m = self.plant.n_outputs
        lines = [f"{len(self.members)} residuals of {m} equations, {len(self.parameters)} parameters; {self.basis}"]
        for name, code, chosen in zip(self.members, self.codes, self.ignored, strict=True):
            fires = ", ".join(cause for cause, on in zip(self.causes, code, strict=True) if on)
            lines.append(f"  {name}: dimension {m - len(chosen)}, answers to {fires}")
        return "\n".join(lines)


@method(
    designs_for="model with parameters",
    needs=["sampled", "parameters with nominal values"],
    exists_when="fewer parameters ignored at a time than equations",
    order="sum of the orders of the equations",
    source="Gertler (1991), eqs. (6-7) to (6-13)",
    faults="by code: which parameter has changed",
    noise="moving average",
)
def insensitive_parity(
    model: Model,
    parameters: Mapping[str, float],
    *,
    insensitive_to: Iterable[str] | str = (),
    isolate: Iterable[str] | str = (),
    changes: Mapping[str, float] | None = None,
    poles: Sequence[complex] | None = None,
    memory: int = 20,
) -> InsensitiveParity:
    r"""Design residuals that do not answer to small changes of chosen parameters of the model, whatever the inputs.

    The primary residuals :math:`e^*(t, \theta) = H(z, \theta)\, y - G(z, \theta)\, u` have the derivatives

    .. math:: \pi_k(t) = \frac{\partial H}{\partial \theta_k} y - \frac{\partial G}{\partial \theta_k} u

    so that an error :math:`\Delta\theta_k` of the model adds :math:`\pi_k(t) \Delta\theta_k`. A residual that ignores
    the parameters with the derivatives :math:`\Pi(t)` is

    .. math:: r(t) = \left(I - \Pi (\Pi^T \Pi + \epsilon^2 I)^{-1} \Pi^T\right) e^*(t)

    in units in which the noise of ``e*`` is white and each column is the effect of an expected change.

    Guaranteed: of changes :math:`\delta`, in units of the expected ones, at most :math:`\epsilon |\delta| / 2` is left
    to first order, at every sample; the remainder is of second order in the changes.

    Parameters
    ----------
    model : function of the parameters, by name
        Returns a sampled Plant or InputOutputModel. Of a plant the equation of each output is taken; an
        InputOutputModel may have its own, such as one for each balance.
    parameters : mapping of str to float
        Names and nominal values of all parameters that are ignored or isolated.
    insensitive_to : sequence of str
        Parameters that may drift: no residual answers to them.
    isolate : sequence of str
        Parameters whose change is a fault: for each there is a residual that ignores it, besides the one that ignores
        the drifts alone. When both are omitted: all of them, as far as there are equations.
    changes : mapping of str to float, optional
        Expected changes; a tenth of the nominal value when omitted.
    poles : sequence of complex, optional
        As many as the order of the equations, by which they and their derivatives are divided; all zero when omitted,
        the moving average. Slow poles let less of the noise through.
    memory : int
        Samples over which the square of a residual is averaged (exponentially).

    Returns
    -------
    InsensitiveParity
        ``.fit(u, y)`` it to fault-free data, then ``.run(u, y)``; read ``.fired`` with
        ``rs.decide.read_codes(result.fired, parity.codes, parity.causes, members=parity.members)``.

    Raises
    ------
    DesignError
        If more parameters are to be ignored at once than there are equations less one, or a parameter changes nothing.
    ModelError
        If the model is continuous or its signals depend on the parameters.
    AccuracyError
        If derivatives by two steps disagree.

    See Also
    --------
    primary_residuals : The same equations for parameters that are known.
    multi_model_parity : For a list of models.
    robust_l1_bank : Parameters in intervals, with certified thresholds.

    Notes
    -----
    Assumes: the model is linear in its signals; parameters change slowly, compared with the order of the equations; and
    the measured signals stand for the true ones in :math:`\Pi`.

    The paper takes one row :math:`w_i^T(t)` with :math:`w_i^T \Pi = 0`. A row may jump, for the null space of
    :math:`\Pi^T` has no continuous basis in general, and leaves part of the null space unused; the projection here is
    unique, all of the null space, and smooth in the data. Its matrix is the inverse of the covariance that ``e*`` has
    with white noise of unit size and parameters off by :math:`1/\epsilon` expected changes.

    Where :math:`\Pi(t)` loses rank, as at rest, or where two parameters act alike, nothing need be removed: directions
    shorter than :math:`\epsilon` stay in. There is no rank to decide.

    Insensitivity costs: a residual with ``m`` equations that ignores ``k`` parameters has ``m - k`` dimensions left,
    and a fault that acts in the direction of an ignored parameter at some moment is not seen then.

    References
    ----------
    Gertler (1991), eqs. (6-7) to (6-13), where :math:`\Delta\theta` is nominal less true; Gertler, Luo, Anderson
    and Fang (1990).

    Examples
    --------
    >>> import residua as rs
    >>> def motor(R, k):  # current and speed, sampled
    ...     return rs.Plant([[-2 * R, -2 * k], [10 * k, -0.5]], [[2], [0]], [[1, 0], [0, 1]]).discretize(0.02)
    >>> print(rs.design.insensitive_parity(motor, {"R": 1.0, "k": 0.5}, insensitive_to="R"))
    1 residuals of 2 equations, 2 parameters; ...
      ignores R: dimension 1, answers to k, another fault
    """
    values, sizes = checked_parameters(parameters, changes)
    names = tuple(values)
    drifts, isolated = (
        [names[i] for i in arrays.positions(chosen, names, "parameter")] for chosen in (insensitive_to, isolate)
    )
    equations = equations_of(model, values, sizes)
    if not drifts and not isolated:
        isolated = list(names)
    m = len(equations.model.outputs)
    both = [name for name in isolated if name in drifts]
    if both:
        raise DesignError(
            f"parameter {both[0]!r} stands among those to ignore always and among those to isolate: leave it out of one"
        )
    ignored = [tuple(drifts), *((*drifts, name) for name in isolated)]
    longest = max(ignored, key=len)
    if len(longest) > m - 1:
        raise DesignError(
            f"{m} equations leave room for {m - 1} ignored parameter{'s' * (m != 2)} at a time, not for "
            f"{', '.join(longest)}: add a sensor, or ignore fewer"
        )
    members = tuple("ignores " + (" and ".join(one) or "nothing") for one in ignored)
    if memory != int(memory) or memory < 1:
        raise SettingError(f"memory must be a whole number of samples, at least 1, got {memory!r}")
    plant = equations.model.to_plant()
    chosen, k = window_poles(poles, equations.outputs.shape[1] - 1), len(names)
    # the primary residuals and, one parameter after the other, their derivatives
    labels = [f"e{j + 1}" for j in range(m)]
    labels += [f"d{name}/d{j + 1}" for j in range(k) for name in labels]
    weights = np.concatenate([equations.outputs, *equations.output_slopes])
    system = window_filter(weights, np.concatenate([equations.inputs, *equations.input_slopes]), plant, labels, chosen)
    slowest = float(np.abs(chosen).max(initial=0.0))
    settle = len(chosen) + (int(np.ceil(np.log(1e-3) / np.log(slowest))) if slowest > 1e-12 else 0)
    expected = np.array([sizes[name] for name in names])
    which = tuple(tuple(names.index(name) for name in one) for one in ignored)
    filters, none = (system.A, system.B, system.C, system.D), np.full(len(ignored), np.inf)
    running = ParameterRunning(*filters, np.eye(m), expected, which, 1.0, int(memory), settle, none)
    # from rest, under white inputs
    v = np.random.default_rng(41).standard_normal((400, len(plant.inputs)))
    growth = float(spectral_radius(plant.A))
    v = v[: int(np.clip(20 / np.log(growth), 40, 400))] if growth > 1 else v
    data = np.hstack([v, plant.system(("control",)).simulate(v)])
    pi = running.block(running.initial_state(1), data[None])[1].sensitivities[0, settle:]
    squares = (pi**2).mean(axis=0)  # parameters x equations
    terms = running.largest_gains() @ np.sqrt((data**2).mean(axis=0))
    units = np.maximum(np.sqrt(squares.max(axis=0)), 1e-6 * terms)  # an equation may not depend on any parameter
    units = np.where(units > 0, units, 1.0)  # those in which expected changes are of one size in all equations
    rest = 1e-9 * float(np.sqrt((squares / units**2).sum(axis=1).min()))
    running, pi = replace(running, scale=np.diag(1 / units), rest=rest), pi / units
    left = [[without_directions(pi[:, j], pi[:, list(one)], rest) for j in range(k)] for one in running.ignored]
    shares = np.linalg.norm(left, axis=(2, 3)) / np.linalg.norm(pi, axis=(0, 2))
    causes = [name for name in names if name not in drifts]
    seen = shares[:, [names.index(name) for name in causes]] > _APART
    return InsensitiveParity(
        plant,
        values,
        sizes,
        members,
        tuple(ignored),
        (*causes, OTHER),
        np.column_stack([seen, np.ones(len(members), dtype=bool)]),
        shares,
        running,
        None,
        "in units of what expected changes do under white inputs; no thresholds before .fit(u, y)",
    )


def _fitted(
    bare: ParameterRunning, data: NDArray[np.float64], rate: float
) -> tuple[ParameterRunning, list[Promise], int]:
    """Return what runs in units of the noise, the promise of each member, and the number of fault-free samples.

    The statistic of each stretch of time is that in units that the others give, so that the thresholds hold on data
    that the units were not fitted to.

    Parameters
    ----------
    bare : ParameterRunning
    data : ndarray, shape (plants, time, channels)
        Fault-free, of the nominal parameters.
    rate : float
        Fraction of samples over the threshold of each member.
    """
    plants, time, _ = data.shape
    m = len(bare.scale)
    plain = replace(bare, scale=np.eye(m))
    e = plain.block(plain.initial_state(plants), data)[1].primary.reshape(-1, m)
    usable = np.tile(np.arange(time) >= bare.settle, plants)
    count, least = int(usable.sum()), max(10 * m, 30)
    if count < least:
        raise DataError(f"{count} settled samples are too few to fit {m} equations: give at least {least}")
    reach = min(_FORGOTTEN * bare.memory, max(1, (time - bare.settle) // 4))
    seen = FaultFree(e, usable, reach, tuple(range(time, plants * time, time)))
    gains = bare.largest_gains()
    scale, noise_free = _fitted_scale(e[usable], gains, data, bare.scale)
    running = bare if noise_free else replace(bare, scale=scale, rest=REST)
    whole = running.block(running.initial_state(plants), data)[1].statistic.reshape(plants * time, -1)
    statistic = whole.copy()
    for held, kept, _ in () if noise_free else seen.held_out():
        turn = replace(running, scale=_fitted_scale(e[kept], gains, data, bare.scale)[0])
        for p, part in enumerate(seen.parts):
            inside = np.flatnonzero(held[part])
            if len(inside):
                first, last = int(inside[0]), int(inside[-1]) + 1
                begin = max(0, first - bare.settle - reach)
                values = turn.block(turn.initial_state(1), data[p : p + 1, begin:last])[1].statistic[0]
                statistic[part][first:last] = values[first - begin :]
    whole, statistic = np.nan_to_num(whole), np.nan_to_num(statistic)
    held = {"persistence": 1, "release": 1, "window": bare.memory}
    promises = [
        promise_of(observed(one, seen.full, seen.usable, seen.parts, np.inf, own=kept, **held), rate)
        for one, kept in zip(statistic.T, whole.T, strict=True)
    ]
    thresholds = np.array([one.threshold for one in promises])
    return replace(running, thresholds=thresholds), promises, count


def _fitted_scale(
    e: NDArray[np.float64], weights: NDArray[np.float64], signals: NDArray[np.float64], now: NDArray[np.float64]
) -> tuple[NDArray[np.float64], bool]:
    """Return the units that make primary residuals white, and whether these data hold no noise at all.

    ``weights`` are the largest gains from each signal to each residual: residuals below 1e-12 of what they are the
    difference of are rounding, and keep their units.
    """
    terms = weights @ np.abs(signals.reshape(-1, signals.shape[-1])).max(axis=0)
    covariance = e.T @ e / len(e)
    if np.all(np.sqrt(np.diag(covariance)) <= 1e-12 * terms):
        return now, True
    return whitening_matrix(covariance), False
