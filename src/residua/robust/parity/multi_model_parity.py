"""Lou, Willsky and Verghese's parity relations: good for all variants of a plant, exact for none."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from residua import arrays
from residua.design.core.decoupling import Approximate
from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator, make_generator
from residua.design.core.method import method
from residua.design.parity.relation_model import relation_model
from residua.errors import DesignError, ModelError, SettingError
from residua.linear.poles.spectrum import spectral_radius
from residua.plant import Plant
from residua.plant.algebraic_equations import without_algebraic_equations
from residua.plant.input_output_model import InputOutputModel
from residua.robust.parity.best_ratios import best_ratios
from residua.robust.parity.expected_signals import ExpectedSignals, Sizes
from residua.robust.parity.window_filter import window_filter, window_poles
from residua.shown import Shown
from residua.tolerances import RESPONSE_ROUNDING, ROUNDING, TINY

_METHOD = "parity relations for several models"
#: The entry of the evidence that says how far inputs and states reach the residual of the nominal model.
_NOMINAL_LEAK = "leak (rms), nominal model"


@dataclass(frozen=True, eq=False, repr=False)
class MultiModelParity(Shown):
    r"""The most robust relations over a window of samples of several models.

    Attributes
    ----------
    generator : ResidualGenerator
        Of the nominal model. Its residual is not exactly zero without a fault: thresholds must leave room for ``leak``.
    plants : tuple of Plant
        The models; faults to ignore are among their disturbances.
    nominal : int
        The model that the generator counts as its plant.
    ratios : ndarray
        For ``criterion="faults"``: response to constant faults for the leak, of all relations, the largest first.
    singular_values : ndarray, shape ((order + 1) (outputs + inputs),)
        Of all relations of this order, the least robust first: the root mean square of the moving-average residual,
        over all models, in fault-free operation with the expected signals.
    output_weights, input_weights : ndarray, shape (relations, order + 1, channels)
        The relations chosen, the most robust first: the weights of the samples, the oldest first.
    units : ndarray, shape (outputs + inputs,)
        The root mean square of outputs and inputs in operation: the weights times these have length one.
    leak : ndarray, shape (models, relations)
        Root mean square of the residual of the generator in fault-free operation of each model.
    gains : ndarray, shape (models, relations, faults)
        What the residual settles to under a constant fault of size one; NaN for a model that does not settle.
    """

    generator: ResidualGenerator
    plants: tuple[Plant, ...] = field(repr=False)
    nominal: int
    singular_values: NDArray[np.float64]
    ratios: NDArray[np.float64]
    output_weights: NDArray[np.float64] = field(repr=False)
    input_weights: NDArray[np.float64] = field(repr=False)
    units: NDArray[np.float64] = field(repr=False)
    leak: NDArray[np.float64] = field(repr=False)
    gains: NDArray[np.float64] = field(repr=False)

    @property
    def smallest_faults(self) -> NDArray[np.float64]:
        """The constant fault that moves the residual as far as its leak, shape (models, faults).

        By the best of the relations; infinite for a fault that leaves nothing once it has settled.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = self.leak[:, :, None] / np.abs(self.gains)
        ratio = np.where(np.abs(self.gains) > 0, ratio, np.inf)
        return np.min(np.where(np.isnan(self.gains), np.nan, ratio), axis=1, initial=np.inf)

    def __str__(self) -> str:
        s = self.singular_values
        kept = len(self.output_weights)
        what, values = ("faults for leak", self.ratios) if len(self.ratios) else ("singular values", s[::-1])
        following = f"; next {values[kept]:.3g}" if kept < len(values) else ""
        lines = [
            f"{_METHOD}: {kept} of {len(s)} relations of order {self.output_weights.shape[1] - 1}, "
            f"{len(self.plants)} models",
            f"  {what}, kept: {', '.join(f'{x:.3g}' for x in values[:kept])}{following}",
            "  fault that settles to the leak (rms), nominal / worst model:",
        ]
        smallest = self.smallest_faults
        for j, fault in enumerate(self.generator.faults):
            lines.append(f"    {fault}: {smallest[self.nominal, j]:.3g} / {smallest[:, j].max():.3g}")
        return "\n".join(lines)


@method(
    designs_for="several plants",
    needs=["an order", "sampled"],
    exists_when="always; every model has stationary states",
    order="r times the order of the relations",
    source="Lou, Willsky and Verghese (1986); Gertler (1991), eqs. (6-4), (6-5)",
    noise="moving average",
)
def multi_model_parity(
    plants: Iterable[Plant | InputOutputModel],
    *,
    order: int,
    rank: int | None = None,
    relations: int | None = None,
    criterion: str = "leak",
    weights: Sequence[float] | None = None,
    insensitive_to: Iterable[str | int] | str = (),
    inputs: Sizes | None = None,
    disturbances: Sizes | None = None,
    states: Sizes | None = None,
    correlation_time: float = 0.0,
    noise: bool = False,
    nominal: int = 0,
    poles: Sequence[complex] | None = None,
) -> MultiModelParity:
    r"""Design the relations between the last samples that hold best for several models at once.

    Over ``order + 1`` samples the signals of model ``i`` are

    .. math:: \begin{bmatrix} Y \\ U \end{bmatrix} = M_i \zeta, \qquad
              M_i = \begin{bmatrix} R_i & Q_i \\ 0 & I \end{bmatrix} S_i

    with states, inputs, disturbances and ignored faults :math:`S_i \zeta` of expected sizes, ``zeta`` white. With the
    singular value decomposition of :math:`[\sqrt{\pi_1} M_1, \dots, \sqrt{\pi_\kappa} M_\kappa]`, in units of the root
    mean square of each signal, the last left singular vectors are the relations ``w`` that come closest to
    :math:`w^T M_i = 0` for all models.

    Guaranteed: the mean square of :math:`r^* = w^T [Y; U]` over models (with their weights), states and inputs is the
    square of its singular value, and no other set of as many orthonormal ``w`` has a smaller sum.

    Parameters
    ----------
    plants : sequence of Plant or InputOutputModel
        The models, sampled, with the same inputs, outputs and faults; their states may differ.
    order : int
        A relation reads ``order + 1`` samples.
    rank : int, optional
        How many constraints are kept, :math:`\rho`: all other left singular vectors are relations.
    relations : int, optional
        How many relations instead: the best ones. One when both are omitted.
    criterion : {"leak", "faults"}
        What makes a relation good: a small leak for its length, as in the paper, or a large response to constant faults
        for its leak, which the paper leaves to chance.
    weights : sequence of float, optional
        How often each model is met; alike when omitted.
    insensitive_to : sequence of str
        Faults to ignore as far as possible, as disturbances.
    inputs, disturbances : number, sequence, mapping of str to float, or covariance matrix, optional
        Expected root mean squares, or the covariance; one when omitted. Faults to ignore count among the disturbances.
    states : likewise, optional
        Of the states when a window begins; when omitted, the stationary ones that inputs and disturbances make.
    correlation_time : float
        Seconds over which inputs and disturbances stay alike; white when zero. Real inputs move slowly: with white ones
        slow modes and steady states count for little.
    noise : bool
        Whether the noise of the plants counts among the disturbances.
    nominal : int
        The model that the generator counts as its plant.
    poles : sequence of complex, optional
        ``order`` poles by which the relations are divided; all zero when omitted, the moving averages themselves.

    Returns
    -------
    MultiModelParity
        With ``generator``, ``singular_values`` and the ``leak`` of every model.

    Raises
    ------
    DesignError
        If the plants are continuous, ``rank`` or ``relations`` do not fit, or a model has no stationary states.
    ModelError
        If the models have different signals.
    SettingError
        If sizes or weights make no sense.

    See Also
    --------
    optimal_parity : Differences of models as disturbances.
    insensitive_parity : For parameters that drift.
    robust_l1_bank : Thresholds that hold for a whole set.

    Notes
    -----
    Assumes: the plant is one of the models; signals are about as large as expected.

    The paper's condition, eq. (6-4), is on the outputs alone, :math:`w^T [R_1, \dots, R_\kappa] = 0`, with the inputs
    removed by :math:`Q` of one model; here inputs are rows of their own, so that models with different :math:`Q` are
    treated too. For plants without inputs both are one.

    A relation may be robust because it sees nothing: ``gains`` and ``smallest_faults`` tell. With more samples than
    needed the most robust combinations are high differences, which answer to steps for a moment only.
    ``criterion="faults"`` maximises :math:`\lVert w^T F \rVert / \lVert w^T M \rVert` instead, where ``F`` holds what
    faults of size one that last over the window do to the outputs of each model, from rest, and orders the relations by
    that ratio; relations without leak come first.

    Continuous plants are refused: sizes of derivatives mean nothing for signals such as these. Sample them first.

    References
    ----------
    Lou, Willsky and Verghese (1986), Automatica 22(3); Gertler (1991), eqs. (6-4), (6-5).

    Examples
    --------
    >>> import residua as rs
    >>> def variant(a):
    ...     plant = rs.Plant([[a, 0], [0.1, 0.5]], [[1], [0]], [[1, 0], [0, 1]], dt=1.0)
    ...     return plant.with_sensor_faults()
    >>> parity = rs.design.multi_model_parity([variant(a) for a in (0.7, 0.8, 0.9)], order=1)
    >>> parity.singular_values.round(3)  # both outputs are of the same state: one relation is exact for all models
    array([1.88 , 1.106, 1.   , 0.487, 0.057, 0.   ])
    """
    family = plant_family(plants, insensitive_to=insensitive_to)
    if not 0 <= nominal < len(family):
        raise DesignError(f"nominal must be the number of one of {len(family)} models, counted from zero: {nominal!r}")
    if order != int(order) or order < 0:
        raise DesignError(f"order must be a whole number of past samples, got {order!r}")
    pi = np.ones(len(family)) if weights is None else np.asarray(weights, dtype=float)
    if pi.shape != (len(family),) or not np.isfinite(pi).all() or np.any(pi < 0) or not pi.sum() > 0:
        raise SettingError(f"weights must be {len(family)} numbers, one per model, none negative, got {weights!r}")
    pi = pi / pi.sum()
    if criterion not in ("leak", "faults"):
        raise SettingError(f"criterion must be 'leak' or 'faults', got {criterion!r}")
    if criterion == "faults" and rank is not None:
        raise DesignError("rank goes by the leak alone: with criterion='faults' say how many relations, relations=...")
    if rank is not None and relations is not None:
        raise DesignError("give rank, the number of constraints, or relations, the number of relations; not both")
    expected = ExpectedSignals(inputs, disturbances, states, correlation_time, noise)
    names = [f"model {i}" for i in range(len(family))]
    driven = [expected.driven(plant) for plant in family]
    windows = [one.window(order, name) for one, name in zip(driven, names, strict=True)]
    M = np.hstack([np.sqrt(share) * window for share, window in zip(pi, windows, strict=True)])
    rms = np.sqrt((M**2).sum(axis=1).reshape(order + 1, -1).mean(axis=0))
    units = np.where(rms > 0, rms, 1.0)
    scale = np.tile(units, order + 1)
    U, s, _ = np.linalg.svd(M / scale[:, None], full_matrices=M.shape[1] < len(M))
    s, plant = np.concatenate([s, np.zeros(len(M) - len(s))]), family[nominal]
    vectors, ratios = U[:, ::-1].T, np.zeros(0)
    if criterion == "faults":
        vectors, ratios = _by_faults(U, s, _constant_faults(family, pi, order) / scale[:, None])
    most = len(s) if criterion == "leak" else len(vectors)
    count = most - rank if rank is not None else 1 if relations is None else relations
    if count != int(count) or not 1 <= count <= most:
        what = f"rank must be 0 to {most - 1}" if rank is not None else f"relations must be 1 to {most}"
        raise DesignError(f"{what} for windows of {most} values, got {rank if rank is not None else relations!r}")
    flat = vectors[: int(count)] / scale
    largest = flat[np.arange(len(flat)), np.abs(flat).argmax(axis=1)]
    W = (flat * np.where(largest < 0, -1.0, 1.0)[:, None]).reshape(len(flat), order + 1, -1)
    outputs, known = W[:, :, : plant.n_outputs], W[:, :, plant.n_outputs :]
    chosen = window_poles(poles, int(order))
    system = window_filter(outputs, known, plant, [f"r{i + 1}" for i in range(len(W))], chosen)
    leak, notes = np.array([np.linalg.norm(W.reshape(len(W), -1) @ window, axis=1) for window in windows]), []
    if np.any(chosen):
        spread = [one.spread_of(system, name) for one, name in zip(driven, names, strict=True)]
        if any(one is None for one in spread):
            notes.append(
                "the leak is that of the moving averages: with given sizes of states poles have no stationary one"
            )
        else:
            leak = np.array(spread)
    gains = np.array([_steady(outputs, chosen, one) for one in family])
    conditions = {_NOMINAL_LEAK: float(leak[nominal].max()), "leak (rms), worst model": float(leak.max())}
    if criterion == "leak":
        last = {"next singular value": float(s[-len(W) - 1])} if len(W) < len(s) else {}
        conditions = {"largest singular value kept as relation": float(s[-len(W)])} | last | conditions
    evidence = Evidence(
        method=_METHOD,
        poles=system.poles(),
        requested_poles=np.tile(chosen, len(W)),
        conditions=conditions,
        notes=(
            f"good for {len(family)} models, exact for none in general: without a fault the residual stays about as "
            "small as its leak, not zero; thresholds must leave room for it",
            *notes,
        ),
        references=("Lou, Willsky and Verghese (1986)", "Gertler (1991), eqs. (6-4), (6-5)"),
    )
    generator = make_generator(system, plant, _METHOD, evidence, decouples=Approximate(_NOMINAL_LEAK))
    return MultiModelParity(generator, family, nominal, s, ratios, outputs, known, units, leak, gains)


def plant_family(
    plants: Iterable[Plant | InputOutputModel], *, insensitive_to: Iterable[str | int] | str = ()
) -> tuple[Plant, ...]:
    """Return sampled plants without ``E`` and with the same signals, the faults to ignore among their disturbances.

    Raises
    ------
    ModelError
        If there is none, or inputs, outputs, faults or steps differ.
    DesignError
        If they are continuous.
    """
    if isinstance(plants, (Plant, InputOutputModel)):
        plants = [plants]
    explicit = [relation_model(one).plant for one in plants]
    if not explicit:
        raise ModelError("give at least one plant")
    first = explicit[0]
    for i, one in enumerate(explicit):
        for what in ("inputs", "outputs", "faults", "dt"):
            if getattr(one, what) != getattr(first, what):
                raise ModelError(
                    f"model {i} has other {what} than model 0: {getattr(one, what)} instead of {getattr(first, what)}; "
                    "variants of one plant have the same signals"
                )
    if not first.is_discrete:
        raise DesignError(
            "expected sizes are those of samples, not of derivatives: sample the plants first, plant.discretize(dt)"
        )
    chosen = [first.faults[i] for i in arrays.positions(insensitive_to, first.faults, "fault")]
    plain = (one if one.E is None else without_algebraic_equations(one).explicit() for one in explicit)
    return tuple(one.faults_as_disturbances(chosen) if chosen else one for one in plain)


def _constant_faults(family: Sequence[Plant], pi: NDArray[np.float64], order: int) -> NDArray[np.float64]:
    """Return the effect of faults that last over a window on its samples, for every model; the inputs are known."""
    columns = []
    for share, plant in zip(pi, family, strict=True):
        x, rows = np.zeros_like(plant.Bf), []
        for _ in range(order + 1):
            rows += [plant.C @ x + plant.Df, np.zeros((len(plant.inputs), len(plant.faults)))]
            x = plant.A @ x + plant.Bf
        columns.append(np.sqrt(share) * np.vstack(rows))
    return np.hstack(columns)


def _by_faults(
    U: NDArray[np.float64], s: NDArray[np.float64], F: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return relations of unit length in the order of their response to faults for their leak, with that ratio."""
    rank = int(np.count_nonzero(s > ROUNDING * s[0]))
    exact = U[:, rank:]
    left, gains, _ = np.linalg.svd(exact.T @ F, full_matrices=False)
    seeing = int(np.count_nonzero(gains > 1e-9 * max(np.linalg.norm(F), TINY)))
    exact_rows, ratios = (exact @ left[:, :seeing]).T, np.full(seeing, np.inf)
    some, combinations = best_ratios(U[:, :rank].T @ F, np.diag(s[:rank]), rank)
    kept = some > 1e-12 * some.max(initial=0.0)  # the others see nothing
    combinations = combinations[kept] / np.linalg.norm(combinations[kept], axis=1, keepdims=True)
    return np.vstack([exact_rows, combinations @ U[:, :rank].T]), np.concatenate([ratios, some[kept]])


def _steady(outputs: NDArray[np.float64], poles: NDArray[np.complex128], plant: Plant) -> NDArray[np.float64]:
    """Return the steady residual under constant faults on a model; NaN if the model does not settle.

    Exactly zero where that is rounding of terms that cancel.
    """
    n = plant.n_states
    if spectral_radius(plant.A) >= 1:
        return np.full((len(outputs), len(plant.faults)), np.nan)
    x = np.linalg.solve(np.eye(n) - plant.A, plant.Bf)
    y, parts = plant.C @ x + plant.Df, np.abs(plant.C) @ np.abs(x) + np.abs(plant.Df)
    gain, terms = outputs.sum(axis=1) @ y, np.abs(outputs).sum(axis=1) @ parts
    return np.where(np.abs(gain) > RESPONSE_ROUNDING * terms, gain, 0.0) / float(np.prod(1 - poles).real)


def model_spread(
    generator: ResidualGenerator,
    plants: Iterable[Plant | InputOutputModel],
    *,
    inputs: Sizes | None = None,
    disturbances: Sizes | None = None,
    correlation_time: float = 0.0,
    noise: bool = False,
) -> NDArray[np.float64]:
    r"""Return the root mean square of the fault-free residuals of a generator on each of several models.

    Inputs and disturbances are random with their sizes, as for :func:`multi_model_parity`; the mean square is that
    of the stationary filter driven by the plant, from its Lyapunov equation.

    Parameters
    ----------
    generator : ResidualGenerator
        Sampled, of any design.
    plants : sequence of Plant or InputOutputModel
        Stable models with the inputs and outputs of the generator's plant.
    inputs, disturbances : number, sequence, mapping of str to float, or covariance matrix, optional
        Expected root mean squares, or the covariance; one when omitted.
    correlation_time : float
        Seconds over which inputs and disturbances stay alike; white when zero.
    noise : bool
        Whether the noise of the plants counts too.

    Returns
    -------
    ndarray, shape (models, residuals)

    Raises
    ------
    ModelError
        If the signals do not fit.
    DesignError
        If a model is not stable.

    Notes
    -----
    Assumes: the models are linear and time-invariant, and no fault acts.

    References
    ----------
    Gertler (1991), eq. (6-2).

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.Plant([[0.8]], [[1.0]], [[1.0]], dt=1.0)
    >>> other = rs.Plant([[0.7]], [[1.0]], [[1.0]], dt=1.0)
    >>> rs.design.model_spread(rs.design.parity_relations(plant), [plant, other]).round(4)
    array([[0.  ],
           [0.14]])
    """
    family = plant_family(plants)
    reference = generator.plant
    for i, one in enumerate(family):
        if (one.inputs, one.outputs, one.dt) != (reference.inputs, reference.outputs, generator.dt):
            raise ModelError(f"model {i} has other inputs, outputs or another step than the generator")
    expected = ExpectedSignals(inputs, disturbances, None, correlation_time, noise)
    spread = [expected.driven(one).spread_of(generator.system, f"model {i}") for i, one in enumerate(family)]
    return np.array(spread)
