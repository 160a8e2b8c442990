"""Physical parameters from recordings, by the prediction-error method."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import frozen, positions
from residua.decide.checks import check_probability
from residua.errors import DataError, SettingError
from residua.identify.parameter_search import Found, Parameter, PlantAt, Task, parameters_of, search
from residua.identify.prediction import ljung_box
from residua.identify.prediction_errors import NonlinearModel, model_errors, predictor
from residua.identify.segments import gather
from residua.plant import Plant
from residua.progress import Progress, progress_of
from residua.robust.sets.uncertain_plant import UncertainPlant
from residua.shown import Shown
from residua.tolerances import DATA_ROUNDING, TINY
from residua.visible import echo
from residua.words import counted, listing, number, some

Matrix = NDArray[np.float64]
#: Numbers that a fit needs at least for each unknown.
_FOR_EACH_UNKNOWN = 5
#: Lags of the test of whiteness, and the share of the samples that these may be.
_LAGS, _LAG_SHARE = 20, 0.2
#: Below this probability a residual is called coloured.
_COLOURED = 0.01
#: From so large a ratio of variances on, the noise of the plant is said to be another one than that of the data.
_OTHER_NOISE = 1.5
#: Standard errors of the two kinds that differ by more are said to.
_APART = 1.5
#: A number between two bounds, with nothing else known, has this standard deviation in units of their distance.
_FROM_BOUNDS_ALONE = 12**-0.5
#: Singular values this far below the largest are zero: sensitivities are differences of computed predictions.
_NO_EFFECT = 2.0**-23
#: Parameters with a smaller share in a combination, of the largest one, are left out of its name.
_SHARE = 0.05
#: The most lags that are counted, as a fraction of the samples.
_MOST_LAGS = 0.1
#: A correlation of neighbours above this would ask for lags without bound.
_STRONGEST = 0.97


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Identifiability of parameters, by orthogonal combinations of them, in units of the distance of their bounds.

    Attributes
    ----------
    parameters : tuple of str
    singular_values : ndarray, shape (parameters,)
        Of the sensitivities of the whitened prediction errors, largest first: the standard error of a combination is
        one over its value.
    directions : ndarray, shape (parameters, parameters)
        The combinations, one in each row.
    widths : ndarray, shape (parameters,)
        The distance of the bounds of each parameter.
    """

    parameters: tuple[str, ...]
    singular_values: NDArray[np.float64]
    directions: Matrix
    widths: NDArray[np.float64]

    @property
    def unknown(self) -> tuple[int, ...]:
        """The combinations that the data say no more of than the bounds do."""
        s = self.singular_values
        blind = (s * _FROM_BOUNDS_ALONE <= 1) | (s <= _NO_EFFECT * s.max(initial=0.0))
        return tuple(int(i) for i in np.flatnonzero(blind))

    @property
    def condition(self) -> float:
        """The ratio of the largest to the smallest singular value."""
        s = self.singular_values
        return float(s[0] / s[-1]) if s[-1] > 0 else float("inf")

    def moves(self, i: int) -> dict[str, float]:
        """Return the moves of the parameters along a combination, the largest share of the bounds being a whole one.

        Of parameters with even bounds the largest moves by 1; what moves by next to nothing is left out.
        """
        direction, moved = self.directions[i], self.directions[i] * self.widths
        large = np.abs(direction) >= _SHARE * np.abs(direction).max()
        unit = moved[int(np.abs(direction).argmax())]
        return {n: float(v / unit) for n, v, keep in zip(self.parameters, moved, large, strict=True) if keep}

    def standard_error(self, i: int) -> float:
        """Return the standard error of a combination of length one, in units of the bounds."""
        s = float(self.singular_values[i])
        return 1 / s if s > 0 else float("inf")

    def sentence(self, i: int) -> str:
        """Describe the combination that is not known."""
        moves = self.moves(i)
        error = number(self.standard_error(i), 2)
        if len(moves) == 1:
            alone = next(iter(moves))
            return f"the data say nothing of {alone}: its standard error is {error} times the distance of its bounds"
        *others, last = moves
        together = listing(f"{name} by {number(value, 3)}" for name, value in moves.items())
        return (
            f"the data do not tell {listing(others)} from {last}: moved together, {together}, they change no "
            f"prediction by more than the noise hides (standard error {error} times the distance of their bounds)"
        )


def identifiability(
    sensitivities: Sequence[NDArray[np.float64]], parameters: tuple[str, ...], widths: NDArray[np.float64]
) -> Identifiability:
    """Return the identifiability of parameters by the singular values of their sensitivities.

    Parameters
    ----------
    sensitivities : sequence of ndarray, shape (time, outputs, parameters)
        Of the whitened prediction errors, over parameters in units of ``widths``.
    parameters : tuple of str
    widths : ndarray, shape (parameters,)
    """
    k = len(parameters)
    R = np.zeros((0, k))
    for S in sensitivities:
        R = np.linalg.qr(np.vstack([R, S.reshape(-1, k)]), mode="r")
    _, s, directions = np.linalg.svd(np.vstack([R, np.zeros((max(k - len(R), 0), k))]))
    return Identifiability(parameters, s[:k], directions, widths)


def sandwich_covariance(
    sensitivities: Sequence[NDArray[np.float64]], errors: Sequence[Matrix], precision: Matrix
) -> tuple[Matrix, Matrix, int]:
    r"""Return the covariance of an estimate, that for white errors, and the lags that were counted.

    .. math::

       V = H^{-1} \Big(\sum_{|l| \le L} \big(1 - \tfrac{|l|}{L + 1}\big) \sum_t s_t s_{t+l}^T + P\Big) H^{-1}, \qquad
       H = \sum_t \Psi_t^T \Psi_t + P, \qquad s_t = \Psi_t^T e_t

    with whitened errors :math:`e_t`, their sensitivities :math:`\Psi_t` and the precision of the prior, :math:`P`.
    Where the errors are white it is :math:`H^{-1}` but for chance.

    Parameters
    ----------
    sensitivities : sequence of ndarray, shape (time, outputs, parameters)
        Of the weighted errors, one for each stretch of data.
    errors : sequence of ndarray, shape (time, outputs)
        Weighted.
    precision : ndarray, shape (parameters, parameters)
        Of a prior; zero for none.

    References
    ----------
    Newey and West (1987), Econometrica 55(3); the number of lags: Andrews (1991), Econometrica 59(3), eqs. (6.2) and
    (6.4).
    """
    k = len(precision)
    H = sum((np.einsum("tpi,tpj->ij", S, S) for S in sensitivities), np.array(precision, dtype=float))
    inverse = np.linalg.inv(H)
    root = np.linalg.cholesky((inverse + inverse.T) / 2)  # scores in units in which they are alike
    scores = [np.einsum("tpi,tp->ti", S, e) @ root for S, e in zip(sensitivities, errors, strict=True)]
    samples = sum(map(len, scores))
    power = sum((s**2).sum(axis=0) for s in scores)
    neighbours = sum((s[:-1] * s[1:]).sum(axis=0) for s in scores)
    r = np.clip(neighbours / np.maximum(power, TINY), -_STRONGEST, _STRONGEST)
    variance = power / max(samples, 1) * (1 - r**2)
    above = float((4 * r**2 * variance**2 / ((1 - r) ** 6 * (1 + r) ** 2)).sum())
    below = float((variance**2 / (1 - r) ** 4).sum())
    optimal = int(np.ceil(1.1447 * (above / max(below, TINY) * samples) ** (1 / 3)))
    lags = min(optimal, int(_MOST_LAGS * samples))
    middle = sum((s.T @ s for s in scores), np.zeros((k, k)))
    for lag in range(1, lags + 1):
        product = sum((s[:-lag].T @ s[lag:] for s in scores if len(s) > lag), np.zeros((k, k)))
        middle += (1 - lag / (lags + 1)) * (product + product.T)
    middle *= samples / max(samples - k, 1)
    middle += root.T @ precision @ root
    V = root @ middle @ root.T
    return (V + V.T) / 2, (inverse + inverse.T) / 2, lags


@dataclass(frozen=True, eq=False, repr=False)
class GreyBox(Shown):
    """Parameters of a plant that were estimated from recordings.

    Attributes
    ----------
    parameters : dict of str to float
    bounds : dict of str to (float, float)
    standard_errors : dict of str to float
        Roots of the diagonal of ``covariance``.
    covariance : ndarray, shape (parameters, parameters)
        Of the estimate, which holds where the errors are coloured too (sandwich).
    plain_covariance : ndarray, shape (parameters, parameters)
        That for white errors.
    plant : Plant
        The value of the function at the estimate; with the measurement noise of the fit, where it has no noise.
    innovation_covariance : ndarray, shape (outputs, outputs)
        Of the one-step prediction errors, over the fitted samples.
    identifiability : Identifiability
        Identifiability of combinations of the parameters by the data alone.
    at_bounds : tuple of str
        Parameters whose estimate is one of their bounds.
    fit : dict of str to float
        Per output, the part of its spread that the one-step predictions explain, 1 less the ratio of the norms, on the
        part that was held out (of all, if none was).
    simulation_fit : dict of str to float
        The same for what the inputs alone explain, from a fitted start.
    whiteness : dict of str to float
        Per output, the probability of so much correlation over time if the held-out errors were white.
    samples, held_out : int
        Rows that were fitted, and that were not.
    notes : tuple of str
    """

    parameters: dict[str, float]
    bounds: dict[str, tuple[float, float]]
    standard_errors: dict[str, float]
    covariance: Matrix
    plain_covariance: Matrix
    plant: Plant
    innovation_covariance: Matrix
    identifiability: Identifiability
    at_bounds: tuple[str, ...]
    fit: dict[str, float]
    simulation_fit: dict[str, float]
    whiteness: dict[str, float]
    samples: int
    held_out: int
    notes: tuple[str, ...]
    function: Callable[[Mapping[str, float]], Plant] = field(repr=False)

    def interval(self, level: float = 0.95, *, together: bool = False) -> dict[str, tuple[float, float]]:
        """Return an interval for each parameter, within its bounds.

        Parameters
        ----------
        level : float
            The probability that the interval holds the parameter, for normal errors.
        together : bool
            That all intervals hold at once, by Bonferroni's inequality.

        Raises
        ------
        SettingError
            If the level is no probability below 1.
        """
        from scipy.special import ndtri  # slow to import, and needed only here

        check_probability(level, "level")
        out = (1 - level) / (2 * len(self.parameters) if together else 2)
        width = -float(ndtri(out))
        return {
            name: (max(low, value - width * error), min(high, value + width * error))
            for (name, value), (low, high), error in zip(
                self.parameters.items(), self.bounds.values(), self.standard_errors.values(), strict=True
            )
        }

    def uncertain_plant(self, level: float = 0.95) -> UncertainPlant:
        """Return the plants within a box that holds the parameters with a probability: the estimate is nominal.

        The box is that of :meth:`interval` with ``together``. Its corners are further out than the covariance says
        where parameters are correlated; no member of the ellipsoid's projection on an axis is left out.

        Parameters
        ----------
        level : float

        Returns
        -------
        UncertainPlant
            Of :meth:`residua.UncertainPlant.from_parameters`; ``.linearisation`` says what its affine form leaves out.
        """
        box = self.interval(level, together=True)
        return UncertainPlant.from_parameters(
            self.function, {name: (low, self.parameters[name], high) for name, (low, high) in box.items()}
        )

    @property
    def report(self) -> str:
        """The estimate as a table, with notes."""
        return str(self)

    def __str__(self) -> str:
        plain = np.sqrt(np.diag(self.plain_covariance))
        rows = [["parameter", "estimate", "std. error", "if white", "bounds"]]
        for (name, value), error, white in zip(
            self.parameters.items(), self.standard_errors.values(), plain, strict=True
        ):
            low, high = self.bounds[name]
            edge = " (at a bound)" if name in self.at_bounds else ""
            cells = [name, number(value, 6), number(error, 2), number(float(white), 2)]
            rows.append([*cells, f"{number(low)} to {number(high)}{edge}"])
        outputs = [["output", "prediction fit", "simulation fit", "whiteness p", "std. of errors"]]
        for i, name in enumerate(self.plant.outputs):
            spread = float(np.sqrt(self.innovation_covariance[i, i]))
            fits = self.fit[name], self.simulation_fit[name]
            shares = [f"{100 * one:.1f} %" if np.isfinite(one) else number(one) for one in fits]
            outputs.append([name, *shares, number(self.whiteness[name], 2), number(spread, 3)])
        where = f"{self.held_out} held-out samples" if self.held_out else "the fitted samples: nothing was held out"
        head = (
            f"grey box: {counted(len(self.parameters), 'parameter')} of {self.plant.name!r} from {self.samples} samples"
        )
        notes = [f"note: {note}" for note in self.notes]
        return "\n".join([head, *_table(rows), f"on {where}", *_table(outputs), *notes])


def grey_box(
    plant_at: Callable[..., Plant | NonlinearModel],
    recordings: Any,
    parameters: Mapping[str, Sequence[float]],
    *,
    y: ArrayLike | None = None,
    dt: float | None = None,
    offsets: bool | Iterable[str] = False,
    priors: Mapping[str, Sequence[float]] | None = None,
    held_out: float = 0.25,
    starts: int = 8,
    progress: Progress | bool | None = None,
) -> GreyBox:
    r"""Estimate physical parameters of a plant from fault-free recordings.

    .. math::

       \hat\theta = \arg\min_\theta \log\det \sum_t e_t(\theta) e_t(\theta)^T, \qquad
       e_t = y_t - \hat y_{t | t - 1}(\theta)

    with the one-step predictions of the stationary Kalman filter where the plant has process noise; without, those of
    a simulation (output error). A continuous plant is sampled at the step of the recordings. The state at the start of
    each stretch of data is estimated with the parameters. The plant's operating point is part of the model: what it
    says of the parameters counts, unless ``offsets`` are estimated too.

    Guaranteed: an estimate is returned only where the data (with the priors) say more of every combination of
    parameters than its bounds do. Nothing depends on units.

    Parameters
    ----------
    plant_at : callable
        ``plant_at(**parameters)``, or a function of one mapping, which returns a :class:`residua.Plant`, for example by
        :func:`linearise`; or a :class:`NonlinearModel`, for recordings that move far from one operating point. Faults
        and disturbances are kept, and play no part in the fit.
    recordings : Recording, data frame, path, pair (u, y), or a list of these
        Without faults. The channels of the plant are looked up by name; arrays have them in the plant's order. Rows
        with a missing value cut a recording, and nothing is interpolated.
    parameters : mapping of str to (low, high) or (low, start, high)
        Bounds, which may be infinite with a start.
    y : array_like, shape (time, outputs), optional
        With ``recordings`` as the inputs, shape (time, inputs).
    dt : float, optional
        Step in seconds, for arrays; that of a sampled plant when omitted.
    offsets : bool or sequence of str
        Channels with an unknown constant offset in each stretch of data; all outputs for ``True``.
    priors : mapping of str to (mean, standard deviation), optional
        Prior knowledge of parameters, as normal distributions.
    held_out : float
        The last part of each recording that is not fitted: fit and whiteness are those of it. 0 holds nothing out.
    starts : int
        Points within the bounds that are compared before the search, where no start is given.
    progress : callable, bool, optional
        Is called with (stage, done, total); a bar on a terminal when omitted.

    Returns
    -------
    GreyBox

    Raises
    ------
    DataError
        If a channel is missing, there are too few samples, or the data say nothing of a combination of parameters: the
        message names it.
    ModelError
        If ``plant_at`` raises or gives no plant, or no predictor exists: the message says for which values.
    SettingError
        If bounds, priors, or ``held_out`` are none.

    See Also
    --------
    linearise : A plant from one's own equations.
    NonlinearModel : The equations as they are.

    Notes
    -----
    Assumes: no faults in the recordings; a linear plant near its operating point; the structure is right. Standard
    errors hold for many samples and inside of the bounds. In closed loop the noise model must be right, or the
    estimate is off by what the controller feeds back of it: coloured errors say so. With ``offsets`` the start of a
    stretch and its offsets are taken out of the errors by projection, exactly. Sensitivities are differences.

    References
    ----------
    Ljung (1999), System Identification, sections 7.2 (prediction errors), 9.2 and 9.3 (covariance), 16.5 (whiteness);
    Golub and Pereyra (1973), SIAM J. Numer. Anal. 10(2) (start and offsets); Newey and West (1987), Econometrica 55(3).

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> def tank(outflow):
    ...     return rs.Plant([[-outflow]], [[1.0]], [[1.0]], inputs="inflow", outputs="level")
    >>> rng = np.random.default_rng(0)
    >>> u = np.repeat(rng.standard_normal((40, 1)), 10, axis=0)
    >>> level = tank(0.2).discretize(1.0).system().simulate(u) + 0.1 * rng.standard_normal((400, 1))
    >>> model = rs.identify.grey_box(tank, (u, level), {"outflow": (0.05, 1.0)}, dt=1.0)
    >>> abs(model.parameters["outflow"] - 0.2) < 3 * model.standard_errors["outflow"] < 0.01
    True
    """
    known, started = parameters_of(parameters)
    call = PlantAt(plant_at, tuple(p.name for p in known))
    first = call.plant({p.name: p.start for p in known})
    step = dt if dt is not None or not first.is_discrete else first.dt
    everything = gather(recordings, y, inputs=first.inputs, outputs=first.outputs, dt=step)
    fitted, rest = everything.divided(held_out)
    if not isinstance(starts, (int, np.integer)) or starts < 1:
        raise SettingError(f"starts must be a positive whole number, got {echo(starts)}")
    channels = first.inputs + first.outputs
    named = (first.outputs if offsets else ()) if isinstance(offsets, bool) else offsets
    unknown = tuple(positions(named, channels, "offsets: channel"))
    task = Task(call, known, fitted.data(), everything.dt, unknown, _prior_numbers(priors, known))
    unknowns = len(task.parameters) + len(task.data) * (first.n_states + len(task.offsets))
    rows = sum(map(len, task.data))
    if rows * first.n_outputs < _FOR_EACH_UNKNOWN * unknowns:
        raise DataError(
            f"{counted(rows, 'row')} to fit ({everything.n_samples} in all, some held out) of "
            f"{counted(first.n_outputs, 'output')} are too few for {unknowns} unknowns: "
            f"{len(task.parameters)} parameters, and {first.n_states} states and {len(task.offsets)} offsets in "
            f"each of {len(task.data)} stretches; at least {_FOR_EACH_UNKNOWN} numbers for each are needed"
        )
    y = np.vstack(task.data)[:, -first.n_outputs :]
    still = np.ptp(y, axis=0) <= DATA_ROUNDING * np.abs(y).max(axis=0)
    if still.any():
        raise DataError(
            f"{some(n for n, s in zip(first.outputs, still, strict=True) if s)} never moves in the {len(y)} fitted "
            "rows: a constant sensor determines no parameter; leave the output out of the plant"
        )
    tell, close = progress_of(progress)
    try:
        found = search(task, 1 if started else int(starts), tell)
        return _outcome(task, found, rest.data(), everything.notes)
    finally:
        close()


def _prior_numbers(priors: Mapping[str, Sequence[float]] | None, known: tuple[Parameter, ...]) -> Matrix:
    """Return means and standard deviations of the priors in the units of the search."""
    out = np.vstack([np.zeros(len(known)), np.full(len(known), np.inf)])
    names = [p.name for p in known]
    for name, values in (priors or {}).items():
        if name not in names:
            raise SettingError(f"priors: {echo(name)} is no parameter; known: {some(names)}")
        p = known[names.index(name)]
        try:
            mean, spread = (float(v) for v in values)
        except (TypeError, ValueError) as error:
            raise SettingError(f"priors[{name!r}] must be (mean, standard deviation), got {echo(values)}") from error
        if not (np.isfinite([mean, spread]).all() and spread > 0):
            raise SettingError(f"priors[{name!r}] must be (mean, standard deviation), finite, got {echo(values)}")
        out[:, names.index(name)] = (mean - p.start) / p.width, spread / p.width
    return out


def _outcome(task: Task, found: Found, held_out: list[Matrix], notes: tuple[str, ...]) -> GreyBox:
    """Return the estimate with its covariance and checks, or name the parameters that the data leave open."""
    names = tuple(p.name for p in task.parameters)
    S = task.sensitivities(found.z, found.weights)
    facts = identifiability(S, names, task.widths)
    rows = task.prior_rows(found.z)[1]
    both = identifiability([*S, rows[:, None, :]], names, task.widths) if len(rows) else facts
    if facts.unknown and both.unknown:
        nothing = "; ".join(both.sentence(i) for i in both.unknown)
        raise DataError(
            f"{nothing}. Fix a parameter of the combination, give a prior "
            "(priors={name: (mean, standard deviation)}), or a recording in which the inputs move more"
        )
    notes += (*found.notes, *(f"{facts.sentence(i)}; the priors do" for i in facts.unknown))
    errors = task.errors(found.z).projected(found.weights)
    sandwich, plain, lags = sandwich_covariance(S, errors, rows.T @ rows)
    scale = np.outer(task.widths, task.widths)
    values, covariance = task.values(found.z), found.covariance

    def function(values: Mapping[str, float]) -> Plant:
        """Return the plant, with measurement noise where it has no noise."""
        plant = task.plant_at.plant(values)
        noise = covariance if plant.is_discrete else covariance * task.dt
        return plant if plant.noises else plant.with_noise(measurement=noise)

    plant = function(values)
    checked = held_out if sum(map(len, held_out)) > _LAGS else task.data
    prediction, simulation, whiteness = _checks(task, plant, checked, found)
    at_bounds = tuple(name for name, at in zip(names, found.at_bound, strict=True) if at)
    spread = np.sqrt(np.diag(sandwich * scale))
    notes += _remarks(task, found, at_bounds, whiteness, np.sqrt(np.diag(sandwich) / np.diag(plain)), lags)
    return GreyBox(
        values,
        {p.name: (p.low, p.high) for p in task.parameters},
        {name: float(s) for name, s in zip(names, spread, strict=True)},
        frozen(sandwich * scale),
        frozen(plain * scale),
        plant,
        frozen(covariance),
        facts,
        at_bounds,
        prediction,
        simulation,
        whiteness,
        sum(map(len, task.data)),
        sum(map(len, held_out)) if checked is held_out else 0,
        notes,
        function,
    )


def _checks(
    task: Task, plant: Plant, data: list[Matrix], found: Found
) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    """Return the fit of predictions and of simulations, and the whiteness of the errors, for each output."""
    p = plant.n_outputs
    size = np.sqrt(np.diag(found.covariance))
    weights = np.diag(1 / np.where(size > 0, size, 1.0))
    mean = np.vstack([d[:, -p:] for d in data]).mean(axis=0)
    model = task.plant_at(task.values(found.z))
    spread = np.sqrt(sum(((d[:, -p:] - mean) ** 2).sum(axis=0) for d in data))
    out = []
    for simulation in (False, True):
        errors = model_errors(model, data, task.dt, task.offsets, simulation=simulation).projected(weights)
        unexplained = np.sqrt(sum((e**2).sum(axis=0) for e in errors)) / np.diag(weights)
        out.append(1 - unexplained / np.where(spread > 0, spread, np.nan))
        if not simulation:
            white = _whiteness(errors)
    return tuple({n: float(v) for n, v in zip(plant.outputs, one, strict=True)} for one in (*out, white))  # pyright: ignore


def _whiteness(errors: list[Matrix]) -> NDArray[np.float64]:
    """Return the probability of the correlation over time in each column if it was white."""
    samples = sum(map(len, errors))
    lags = range(max(min(_LAGS, int(_LAG_SHARE * samples)), 1) + 1)
    products = np.array([sum((e[lag:] * e[: max(len(e) - lag, 0)]).sum(axis=0) for e in errors) for lag in lags])
    pairs = np.array([sum(max(len(e) - lag, 0) for e in errors) for lag in lags])
    power = np.where(products[0] > 0, products[0], 1.0)
    return ljung_box(products[1:] / power, pairs[1:], samples)


def _remarks(
    task: Task,
    found: Found,
    at_bounds: tuple[str, ...],
    whiteness: dict[str, float],
    ratio: NDArray[np.float64],
    lags: int,
) -> tuple[str, ...]:
    """Return notes on the estimate."""
    out = []
    if at_bounds:
        out.append(f"{some(at_bounds)}: the estimate is a bound, and its standard error holds only inside")
    coloured = [name for name, p in whiteness.items() if p < _COLOURED]
    if coloured:
        out.append(
            f"the prediction errors of {some(coloured)} are correlated over time: the model leaves out something, or "
            "its noise is another one; the standard errors count that, the predictions do not"
        )
    if ratio.max() > _APART or ratio.min() < 1 / _APART:
        times = " to ".join(dict.fromkeys(number(float(r), 2) for r in (ratio.min(), ratio.max())))
        out.append(f"standard errors are {times} times those for white errors (over {counted(lags, 'lag')})")
    modelled = predictor(task.plant_at.plant(task.values(found.z)), task.dt).innovation_covariance
    if modelled is not None:
        variances = np.diag(found.covariance) / np.diag(modelled)
        names = task.plant_at.like.outputs if task.plant_at.like else ()
        off = [
            f"{n} {number(float(v), 2)}"
            for n, v in zip(names, variances, strict=True)
            if not 1 / _OTHER_NOISE < v < _OTHER_NOISE
        ]
        if off:
            out.append(
                f"the variance of the prediction errors is not what the noise of the plant gives, but times {some(off)}"
            )
    return tuple(out)


def _table(rows: list[list[str]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ["  " + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]
