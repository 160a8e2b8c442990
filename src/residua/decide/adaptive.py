"""Threshold that adapts to the inputs, so that errors of the model raise no alarm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.decide.checks import is_number
from residua.decide.confident_thresholds import promise_by
from residua.decide.false_alarms import observed
from residua.decide.fault_free import FaultFree, check_enough
from residua.decide.model_errors import (
    OutputError,
    ParameterBox,
    errors_of_gains,
    errors_of_parameters,
    residual_errors,
)
from residua.decide.persistence import AlarmRuns
from residua.decide.row_norms import row_norms
from residua.decide.test import Block, FaultFreeRun, ResidualTest, Tested, Watched
from residua.decide.whitened_norm import (
    RUNS,
    NormSettings,
    NormTest,
    against_threshold,
    norm_test_from_model,
    whitened_residuals,
)
from residua.decide.window import WindowState, empty_window, moving_sum
from residua.design import ResidualGenerator
from residua.errors import DataError, FileFormatError, SettingError
from residua.linear import StateSpace
from residua.linear.systems.recursion import ordered_product, run_filter
from residua.number_kinds import BOUND, INDEX, POSITIVE, PROBABILITY, NumberKind
from residua.records import values_out
from residua.tolerances import SIGNAL_ROUNDING
from residua.visible import echo
from residua.words import counted, number

#: Weights of errors are fitted with that part of the samples over the threshold, or with so many.
_SHARE, _OVER = 0.01, 50
#: Most samples that they are fitted to, and errors that the basis names.
_MOST, _NAMED = 20_000, 4


@dataclass(frozen=True, eq=False)
class AdaptiveState:
    """State of an adaptive threshold.

    Attributes
    ----------
    window, error_window : WindowState
        Of the whitened residual, and of the effects of model errors on it.
    runs : AlarmRuns
    x : ndarray, shape (plants, states)
        Of the system of these errors.
    held : ndarray, shape (plants, inputs)
        The last values of the inputs.
    running : ndarray of bool, shape (plants,)
        Whether there was a first sample.
    """

    window: WindowState
    error_window: WindowState
    runs: AlarmRuns
    x: NDArray[np.float64]
    held: NDArray[np.float64]
    running: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _Part:
    """The system of one error: its states and rows among those of all, and its steady-state gain."""

    states: NDArray[np.int64]
    rows: NDArray[np.int64]
    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]
    settled: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AdaptiveTest(NormTest):
    """Fitted threshold that adapts to the inputs.

    Attributes
    ----------
    errors : tuple of str
        Names of the errors of the model.
    A, B, C, D : ndarray
        The system from the inputs to the effect of each error on the whitened residual: as many outputs for each as
        there are residuals.
    orders : ndarray of int, shape (errors,)
        The number of states of each.
    weights : ndarray, shape (errors,)
        Weight of each error.
    together : bool
        Whether one of them holds at a time, so that the largest counts, and not their sum.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {**NormTest.NUMBER_KINDS, "weights": BOUND, "orders": INDEX}

    errors: tuple[str, ...] = field(kw_only=True)
    A: NDArray[np.float64] = field(kw_only=True)
    B: NDArray[np.float64] = field(kw_only=True)
    C: NDArray[np.float64] = field(kw_only=True)
    D: NDArray[np.float64] = field(kw_only=True)
    orders: NDArray[np.int64] = field(kw_only=True)
    weights: NDArray[np.float64] = field(kw_only=True)
    together: bool = field(kw_only=True)

    def start(self, plants: int) -> AdaptiveState:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return the state before the first sample."""
        return AdaptiveState(
            empty_window(plants, self.window, self.whitening.shape[1]),
            empty_window(plants, self.window, len(self.C)),
            AlarmRuns.empty(plants),
            np.zeros((plants, len(self.A))),
            np.zeros((plants, self.B.shape[1])),
            np.zeros(plants, dtype=bool),
        )

    def run(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, state: AdaptiveState, block: Block
    ) -> tuple[AdaptiveState, Tested]:
        """Compare the norm of the whitened residual, less the part that model errors explain, with the threshold."""
        state, q, usable, norms, explained = self.measured(state, block)
        statistic = np.where(usable, np.maximum(norms - self._worth(explained), 0.0), np.nan)
        runs, tested = against_threshold(self, state.runs, statistic, usable, q)
        return replace(state, runs=runs), tested

    def measured(
        self, state: AdaptiveState, block: Block
    ) -> tuple[AdaptiveState, NDArray, NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64]]:
        """Return the state, the whitened residual, its usable mask, its norms, and those of each error."""
        q, usable = whitened_residuals(self.center, self.whitening, block)
        sums, window = moving_sum(q, state.window, usable)
        x, held, running, signed = self._of_errors(state, block)
        parts, error_window = moving_sum(signed, state.error_window, usable)
        k, root = self.whitening.shape[1], np.sqrt(self.window)
        explained = row_norms(parts.reshape(*parts.shape[:2], len(self.errors), k)) / root
        state = replace(state, window=window, error_window=error_window, x=x, held=held, running=running)
        return state, q, usable, row_norms(sums) / root, explained

    def _of_errors(
        self, state: AdaptiveState, block: Block
    ) -> tuple[NDArray, NDArray, NDArray[np.bool_], NDArray[np.float64]]:
        """Return state, held inputs, a flag for inputs seen so far, and the effect of each error on the residual."""
        plants, time = block.usable.shape
        m = self.B.shape[1]
        if block.signals is None:
            raise DataError("an adaptive threshold needs the inputs, but only residuals are given")
        u = _without_gaps(block.signals[..., :m], state.held)
        if not time:
            return state.x, state.held, state.running, np.zeros((plants, 0, len(self.C)))
        x, fresh, signed = state.x.copy(), ~state.running, np.empty((plants, time, len(self.C)))
        for part in self._parts:
            if fresh.any():  # as if the plant had settled to its first inputs
                x[np.ix_(fresh, part.states)] = ordered_product(u[fresh, 0], part.settled)
            x[:, part.states], signed[..., part.rows] = run_filter(
                part.A, part.B, part.C, part.D, np.ascontiguousarray(x[:, part.states]), u
            )
        return x, u[:, -1].copy(), np.ones(plants, dtype=bool), signed

    @cached_property
    def _parts(self) -> tuple[_Part, ...]:
        """The systems of the errors, one by one: together they are one with blocks on its diagonal."""
        k, first, out = self.whitening.shape[1], 0, []
        for g, order in enumerate(self.orders.tolist()):
            states, rows = np.arange(first, first + order), np.arange(g * k, (g + 1) * k)
            A, B = self.A[np.ix_(states, states)], self.B[states]
            settled = np.linalg.solve(np.eye(order) - A, B).T
            C = self.C[np.ix_(rows, states)]
            matrices = [np.ascontiguousarray(M, dtype=np.float64) for M in (A, B, C, self.D[rows], settled)]
            out.append(_Part(states, rows, *matrices))
            first += order
        return tuple(out)

    def _worth(self, explained: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the rise of the threshold at each sample."""
        out = np.zeros(explained.shape[:2])
        for g, weight in enumerate(self.weights.tolist()):  # one after the other: the same bits for any block
            part = weight * explained[..., g]
            out = np.maximum(out, part) if self.together else out + part
        return out

    # ----------------------------------------------- interface to the rest of a monitor

    @property
    def reads_signals(self) -> bool:
        """True: the threshold depends on the inputs."""
        return True

    @property
    def mean_time(self) -> None:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Unknown: longer than for noise alone."""
        return None

    def fault_free_residuals(self, normal: NDArray[np.float64]) -> None:
        """Return ``None``: the threshold depends on the inputs."""
        return None

    def in_white_units(self, response: NDArray[np.float64]) -> None:
        """Return ``None``: errors of the model are not white."""
        return None

    def words(self, step: float) -> dict[str, str]:
        """Describe the threshold, the statistic, and the start and end of an alarm."""
        said = super().words(step)
        how = "the largest" if self.together else "the sum"
        more = f", less {how} of the effects of {counted(len(self.errors), 'error')} of the model"
        return said | {"test": said["test"] + more}

    # --------------------------------------------------------------------------- files

    def check(self, watched: Watched) -> None:
        """Raise if a test from a file does not fit the watched generator."""
        super().check(watched)
        n, m, rows = len(self.A), len(watched.generator.plant.inputs), len(self.errors) * watched.generator.n_residuals
        shapes = {"A": (n, n), "B": (n, m), "C": (rows, n), "D": (rows, m), "weights": (len(self.errors),)}
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise FileFormatError(f"fitted.{name} must have the shape {shape}")
        if self.orders.shape != (len(self.errors),) or int(self.orders.sum()) != n:
            raise FileFormatError(f"fitted.orders must be {len(self.errors)} numbers of states, {n} together")
        if n and not np.abs(np.linalg.eigvals(self.A)).max() < 1:
            raise FileFormatError("fitted.A must be stable")

    def check_state(self, state: AdaptiveState) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Raise if a state from a file is invalid."""
        state.window.check("state.test.window")
        state.error_window.check("state.test.error_window")


@dataclass(frozen=True)
class Adaptive(NormSettings):
    r"""Alarm while the norm of the residual exceeds a threshold that adapts to the inputs.

    .. math:: J_k > a + \sum_j b_j\, |\varphi_{j,k}|, \qquad \varphi_j = W\, G_{ry}\, \Delta G_j\, u

    with the norm :math:`J` of :class:`residua.decide.NormThreshold`, and the effect of an error :math:`\Delta G_j` of
    the model on it for the given inputs, through the residual generator :math:`G_{ry}` and the whitening :math:`W`. A
    plant that does not move is judged as sharply as its noise allows, and large inputs raise no alarm by themselves.

    The errors are

    * with ``relative=0.05``: each output answers to each input up to 5 % more or less than the model says, independent
      of the others: an error of gains, not of time constants;
    * with an uncertain plant: its parameters are anywhere within their bounds. Of up to four all corners of the box are
      looked at, and the largest counts; of more each alone, at its far end, and all of them are added;
    * with neither, those of the responses and of their timing, by as much as a fit finds that they are:
      :math:`a + \sum_j b_j |\varphi_j|` is the line of quantiles of :math:`J` with the least error
      (:math:`b_j \ge 0`), moved until false alarms have the requested rate, and never below the threshold for
      noise alone.

    Guaranteed: with ``relative``, and noise as the model says, single samples over the threshold are at most as
    frequent as asked for, for any inputs and any errors of that size, by the inequality of the triangle
    :math:`|W (r^0 + \sum_j \delta_j r_j)| \le |W r^0| + \sum_j |\delta_j| |W r_j|`; to the first order of the
    parameters of an uncertain plant.

    Parameters
    ----------
    relative : float, UncertainPlant, or None
        How wrong the model may be. ``None``: as wrong as a fit finds it.
    threshold, persistence, release, window, whiten, false_alarm_rate, source
        As of :class:`residua.decide.NormThreshold`; the threshold is that at rest, :math:`a`.
    errors : sequence of OutputError, optional
        Errors made from an uncertain plant; stored in files.

    Raises
    ------
    SettingError
        If the size of the errors is not positive, or the plant has no inputs, or the residual is to be tested in parts.
    ModelError
        If the plant is not stable, so that errors of its responses have no bound; or has other inputs or outputs.

    See Also
    --------
    residua.decide.NormThreshold : The same with a fixed threshold.
    residua.design.multi_model_parity, residua.design.insensitive_parity : Residuals that errors move little.

    Notes
    -----
    Assumes: the plant is stable; errors are constant in time; the noise is as the model or the fit says. A fit holds
    for inputs like those of its recordings. The effect of inputs before the first one is unknown: the plant is taken to
    have settled to the first. Where it moves as the monitor starts, errors of the model raise alarms until the plant
    itself has forgotten that, which may take longer than the filter does: ``Monitor(settle=...)`` with as many samples.

    References
    ----------
    Horak (1988), Journal of Guidance, Control, and Dynamics 11(6), 508-516 (bounds at each sample from those of
    parameters); Emami-Naeini, Akhter and Rock (1988), IEEE Transactions on Automatic Control 33(12), 1106-1115 (the
    threshold selector); Koenker and Bassett (1978), Econometrica 46(1), 33-50 (regression of quantiles).

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
    >>> plant = plant.with_sensor_faults().with_noise(process=1e-6, measurement=1e-4)
    >>> observer = rs.design.kalman_filter(plant)
    >>> u = np.where(np.arange(400) % 200 < 100, 0.0, 10.0)[:, None]
    >>> y = 1.04 * plant.system("control").simulate(u)  # the true gain is 4 % larger
    >>> fixed, moving = (rs.Monitor(observer, test=test) for test in (None, rs.decide.Adaptive(relative=0.05)))
    >>> len(fixed.run(u, y).alarms) > 0, len(moving.run(u, y).alarms)
    (True, 0)
    """

    kind: ClassVar[str] = "adaptive"
    makes: ClassVar[type[ResidualTest]] = AdaptiveTest
    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {
        **RUNS,
        "threshold": POSITIVE,
        "false_alarm_rate": PROBABILITY,
        "relative": POSITIVE,
    }

    relative: float | ParameterBox | None = field(default=None, kw_only=True)
    errors: tuple[OutputError, ...] = field(default=(), kw_only=True)
    together: bool = field(default=False, kw_only=True)
    channels: tuple[tuple[str, ...], ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        relative = self.relative
        if isinstance(relative, ParameterBox):
            errors, together = errors_of_parameters(relative)
            plant = relative.nominal
            object.__setattr__(self, "errors", errors)
            object.__setattr__(self, "together", together)
            object.__setattr__(self, "channels", (plant.inputs, plant.outputs))
            object.__setattr__(self, "relative", None)
        elif relative is not None:
            if not is_number(relative) or not relative > 0:
                raise SettingError(
                    "relative must be a positive number, such as 0.05 for responses that are wrong by up to 5 %, or an "
                    f"UncertainPlant, got {echo(relative)}"
                )
            object.__setattr__(self, "relative", float(relative))
        object.__setattr__(self, "errors", tuple(self.errors))

    @property
    def bounds_errors(self) -> bool:
        """True if the size of the errors is given."""
        return self.relative is not None or bool(self.errors)

    @property
    def _share(self) -> float | None:
        """Relative error of the responses, if given as a number."""
        return self.relative if isinstance(self.relative, float) else None

    # ------------------------------------------------------------------------ making a test

    def from_model(self, watched: Watched) -> AdaptiveTest | None:
        """Return the test that needs no data; ``None`` when data are needed."""
        if not self.bounds_errors:
            return None
        generator = watched.generator
        base = norm_test_from_model(self, generator.covariance_of_sums(self.window), generator.n_residuals)
        if base is None:
            return None
        names, systems, weights = self._errors_of(generator)
        basis = f"{base.basis}; {self._said(names, weights)}"
        return _with_errors(replace(base, basis=basis), names, systems, weights, self.together)

    def fitted(self, watched: Watched, run: FaultFreeRun, rate: float) -> AdaptiveTest:
        """Return the test fitted to fault-free data, for a rate of false alarms."""
        generator = watched.generator
        data = FaultFree(run.residuals, run.usable, self.window, run.seams)
        k, count = run.residuals.shape[1], int(run.usable.sum())
        check_enough(count, k, self.window)
        if data.spread <= SIGNAL_ROUNDING * run.signal_size() or not data.full.any():
            raise DataError(
                "these residuals hold no noise, from which errors of the model differ: take NormThreshold, "
                "whose threshold is then the level of rounding"
            )
        names, systems, weights = self._errors_of(generator)
        raw = _with_errors(_blank(np.zeros(k), np.eye(k), self), names, systems, weights, self.together)
        left = FaultFree(_without_errors(raw, run, data), run.usable, self.window, run.seams)
        moments = (
            left.moments() if self.whiten in ("auto", "data") else left.moments(whitening=self._known(generator, k))
        )
        blank = _blank(moments.center, moments.whitening, self)
        test = _with_errors(blank, names, systems, weights, self.together)
        norms, explained = _measured(test, run, data.parts)
        shape: dict[str, Any] = {"persistence": self.persistence, "release": blank.release, "window": self.window}
        quiet = observed(left.statistic(moments), data.full, run.usable, data.parts, k, **shape)
        least = promise_by(self.source, quiet, rate)
        worth = test._worth(explained[None])[0]
        if not self.bounds_errors:
            weights, worth = _fitted_worth(norms, explained, data, float(least.threshold), rate)
            test = replace(test, weights=weights)
        excess = np.where(run.usable, np.maximum(norms - worth, 0.0), 0.0)
        promise = promise_by(self.source, observed(excess, data.full, run.usable, data.parts, k, **shape), rate)
        chosen = promise if promise.threshold >= least.threshold else least
        basis = f"fitted to {count} fault-free samples, {chosen}; {self._said(names, test.weights)}"
        if self.threshold is not None:
            basis = f"threshold given, the rest fitted; {self._said(names, test.weights)}"
            return replace(test, threshold=self.threshold, basis=basis)
        return replace(test, threshold=float(chosen.threshold), basis=basis, promised=float(promise.promised))

    def _known(self, generator: ResidualGenerator, k: int) -> NDArray[np.float64]:
        """Return the whitening that does not come from data."""
        if self.whiten == "model":
            base = norm_test_from_model(self, generator.covariance_of_sums(self.window), k)
            if base is not None:
                return base.whitening
        return np.eye(k)

    def _errors_of(
        self, generator: ResidualGenerator
    ) -> tuple[tuple[str, ...], tuple[StateSpace, ...], NDArray[np.float64]]:
        """Return the names of the errors, their systems to the residual, and their weights."""
        plant = generator.plant if generator.plant.is_discrete else generator.plant.discretize(generator.dt)
        errors = self.errors or errors_of_gains(plant, changes=not self.bounds_errors)
        if not errors:
            raise SettingError("no output of this plant responds to an input, to which its threshold could adapt")
        weights = np.full(len(errors), self._share or 1.0)
        return tuple(one.name for one in errors), residual_errors(errors, generator), weights

    def _said(self, names: Sequence[str], weights: NDArray[np.float64]) -> str:
        """Describe the model errors that the threshold allows for."""
        if self.errors:
            how = "the corners of" if self.together else "each of"
            return f"allows for {how} the parameters of an uncertain plant ({counted(len(names), 'error')})"
        if self._share is not None:
            return f"allows for responses that are wrong by {100 * self._share:.4g} % ({len(names)} of them)"
        order = [g for g in np.argsort(-weights, kind="stable").tolist() if weights[g] > 0]
        if not order:
            return "these data show no error of the model: the threshold is constant"
        parts = [f"{names[g]} {number(float(weights[g]), 2)}" for g in order[:_NAMED]]
        more = f" and {len(order) - _NAMED} more" if len(order) > _NAMED else ""
        return f"allows for errors of the model as large as these data show, parts of: {', '.join(parts)}{more}"

    # ----------------------------------------------- interface to the rest of a monitor

    def check(self, watched: Watched) -> None:
        """Raise if the settings do not suit the watched generator."""
        plant = watched.generator.plant
        if watched.parts is not None:
            raise SettingError(
                "Adaptive tests the residual as a whole, but isolation by codes needs a test of each part: take "
                "NormThreshold, or isolate by direction"
            )
        if not plant.inputs:
            raise SettingError("this plant has no inputs, to which a threshold could adapt")
        if self.channels and self.channels != (plant.inputs, plant.outputs):
            raise SettingError(
                f"the uncertain plant has the channels {', '.join(sum(self.channels, ()))}, the plant of the monitor "
                f"{', '.join((*plant.inputs, *plant.outputs))}: they must be the same, in the same order"
            )

    @property
    def remedy(self) -> str:
        """Remedy for a missing threshold."""
        if not self.bounds_errors:
            return super().remedy
        return f"{super().remedy}, or give the plant noise (with_noise)"

    def kept(self, watched: Watched) -> tuple[str, int, int] | None:
        """Return the window, and how many numbers are kept of each of its samples."""
        plant, k = watched.generator.plant, watched.generator.n_residuals
        errors = len(self.errors) or 2 * len(plant.inputs) * len(plant.outputs)
        return f"Adaptive(window={self.window})", self.window, k * (1 + errors)

    # --------------------------------------------------------------------------- files

    def to_record(self) -> dict[str, Any]:
        """Return the settings as a record."""
        return values_out(self)


def _without_gaps(u: NDArray[np.float64], held: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return inputs with missing values held."""
    there = np.isfinite(u)
    if there.all():
        return np.ascontiguousarray(u)
    out, last = np.empty(u.shape), held
    for t in range(u.shape[1]):
        last = np.where(there[:, t], u[:, t], last)
        out[:, t] = last
    return out


def _blank(center: NDArray[np.float64], whitening: NDArray[np.float64], settings: NormSettings) -> NormTest:
    release = settings.release or settings.persistence
    return NormTest(center, whitening, np.inf, settings.persistence, release, settings.window, "")


def _with_errors(
    base: NormTest,
    names: tuple[str, ...],
    systems: Sequence[StateSpace],
    weights: NDArray[np.float64],
    together: bool,
) -> AdaptiveTest:
    """Return a norm test that allows for errors of the model; the systems are from the inputs to the residual."""
    W = base.whitening.T
    return AdaptiveTest(
        base.center,
        base.whitening,
        base.threshold,
        base.persistence,
        base.release,
        base.window,
        base.basis,
        errors=names,
        A=scipy.linalg.block_diag(*[one.A for one in systems]),
        B=np.vstack([one.B for one in systems]),
        C=scipy.linalg.block_diag(*[W @ one.C for one in systems]),
        D=np.vstack([W @ one.D for one in systems]),
        orders=np.array([one.n_states for one in systems], dtype=np.int64),
        weights=weights,
        together=together,
    )


def _measured(
    test: AdaptiveTest, run: FaultFreeRun, parts: Sequence[slice]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the norms of fault-free residuals and the effect of each error, each recording from its own start."""
    norms, explained = [], []
    for part in parts:
        _, _, _, J, phi = test.measured(test.start(1), _block(run, part))
        norms.append(J[0])
        explained.append(phi[0])
    return np.concatenate(norms), np.concatenate(explained)


def _block(run: FaultFreeRun, part: slice) -> Block:
    signals = None if run.signals is None else run.signals[None, part]
    return Block(run.residuals[None, part], run.usable[None, part], signals=signals)


def _without_errors(raw: AdaptiveTest, run: FaultFreeRun, data: FaultFree) -> NDArray[np.float64]:
    """Return the residuals less the least-squares fit of constant errors of the model, which leaves the noise."""
    signed = np.concatenate([raw._of_errors(raw.start(1), _block(run, part))[3][0] for part in data.parts])
    k, rows = run.residuals.shape[1], np.flatnonzero(run.usable)
    rows = rows[:: -(-len(rows) // _MOST)]
    scale = np.sqrt(np.maximum(np.mean(data.deviations[rows] ** 2, axis=0), np.finfo(float).tiny))
    columns = signed.reshape(len(signed), -1, k)
    design = (columns[rows] - columns[rows].mean(axis=0)) / scale
    wanted = (data.deviations[rows] - data.deviations[rows].mean(axis=0)) / scale
    flat = design.transpose(0, 2, 1).reshape(-1, columns.shape[1])
    sizes = np.sqrt(np.sum(flat**2, axis=0))
    sizes[sizes == 0] = 1.0
    theta = np.linalg.lstsq(flat / sizes, wanted.ravel(), rcond=None)[0] / sizes
    explained = np.einsum("tgk,g->tk", columns, theta)
    return np.where(run.usable[:, None], run.residuals - explained, run.residuals)


def _fitted_worth(
    norms: NDArray[np.float64], explained: NDArray[np.float64], data: FaultFree, least: float, rate: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the weights of errors fitted to all samples, and each sample's allowance by samples far from it."""

    def weights_by(rows: NDArray[np.bool_]) -> NDArray[np.float64]:
        return _quantile_weights(norms[rows], explained[rows], least, rate)

    whole = weights_by(data.full)
    worth = explained @ whole
    for held, _, kept in data.held_out():
        if kept.any():
            worth[held] = explained[held] @ weights_by(kept)
    return whole, worth


def _quantile_weights(
    norms: NDArray[np.float64], explained: NDArray[np.float64], least: float, rate: float
) -> NDArray[np.float64]:
    r"""Return the weights of errors: the non-negative coefficients of a quantile regression.

    .. math:: \min_{a, b \ge 0} \sum_k \varrho_\tau(J_k - J_0 - a - \sum_j b_j \varphi_{j,k}), \qquad
       \varrho_\tau(x) = \max(\tau x, (\tau - 1) x)

    by its dual, which has as few conditions as there are errors.
    """
    from scipy.optimize import linprog  # slow to import, and needed only here

    rows = slice(None, None, -(-len(norms) // _MOST))
    wanted, columns = norms[rows] - least, explained[rows]
    over = max(rate, min(_SHARE, _OVER / len(wanted)))
    units = columns.max(axis=0, initial=0.0)
    live = units > 0
    if not live.any():
        return np.zeros(explained.shape[1])
    design = np.hstack([np.ones((len(wanted), 1)), columns[:, live] / units[live]])
    size = max(float(np.abs(wanted).max()), np.finfo(float).tiny)
    made = linprog(
        -wanted / size, A_ub=design.T, b_ub=np.zeros(design.shape[1]), bounds=(-over, 1 - over), method="highs"
    )
    if made.status != 0:
        raise DataError(f"the weights of the model errors could not be fitted ({made.message}): give relative=")
    out = np.zeros(explained.shape[1])
    out[live] = np.maximum(-made.ineqlin.marginals[1:], 0.0) * size / units[live]
    return out


__all__ = ["Adaptive", "AdaptiveTest"]
