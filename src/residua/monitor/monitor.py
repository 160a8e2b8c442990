"""A residual generator with its decision logic, running on data."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.decide.directional import Directional, direction_test
from residua.decide.norm_threshold import (
    NormTest,
    NormThreshold,
    check_rate,
    check_samples,
    fit_norm_test,
    norm_test_from_model,
)
from residua.design import ResidualGenerator
from residua.design.generator import stack_signals
from residua.errors import DataError, ModelError, NotFittedError
from residua.monitor.decision import Decision
from residua.monitor.diagnosis import Diagnosis
from residua.monitor.inputs import settling_samples, signal_size, signals
from residua.monitor.outcome import candidates_at, diagnosis_from
from residua.monitor.running import Decisions, Specification, State, initial_state, run_block

#: Samples per piece when a recording is run: bounds memory and lets progress be shown.
PIECE = 100_000


class Monitor:
    """Watches recorded or live data for faults.

    Data are in plant units: the plant's operating point is subtracted inside. A continuous generator is
    sampled at ``dt``. Missing values (NaN, infinity) never end a run: the last value of that channel is held
    for the filter, no residual is reported on that sample, and nothing is decided until the filter has settled
    again; after more than ``max_hold`` incomplete samples in a row the filter starts anew with the next
    complete sample. A start assumes that the plant was at rest at the first sample: where a state integrates,
    give ``settle`` enough samples.

    Parameters
    ----------
    generator : ResidualGenerator
    test : NormThreshold
        When to raise an alarm.
    isolate : Directional or None
        How to name the fault.
    dt : float, optional
        Step in seconds at which a continuous generator is sampled; may also come from the recording that
        is fitted.
    settle : int, optional
        Samples after a start or a gap in which nothing is decided. By default until the slowest pole of the filter
        has decayed to 1 %.
    max_hold : int
        Longest gap in samples that is bridged by holding values.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
    >>> plant = plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)
    >>> monitor = rs.Monitor(rs.design.kalman_filter(plant))
    >>> u, y = np.ones((200, 1)), np.ones((200, 1))
    >>> y[100:] += 1.0
    >>> monitor.run(u, y).onset
    100.0
    """

    def __init__(
        self,
        generator: ResidualGenerator,
        *,
        test: NormThreshold | None = None,
        isolate: Directional | None = Directional(),  # noqa: B008 (frozen)
        dt: float | None = None,
        settle: int | None = None,
        max_hold: int = 10,
    ) -> None:
        if not isinstance(generator, ResidualGenerator):
            raise ModelError(
                f"a monitor runs a residual generator, got {type(generator).__name__}"
                + ("; use its residual_generator()" if hasattr(generator, "residual_generator") else "")
            )
        if settle is not None:
            check_samples(settle, "settle", least=0)
        check_samples(max_hold, "max_hold", least=0)
        self.design = generator
        self.test = NormThreshold() if test is None else test
        self.isolate = isolate
        self.settle = settle
        self.max_hold = int(max_hold)
        self.notes: tuple[str, ...] = ()
        self._generator: ResidualGenerator | None = None
        self._norm_test: NormTest | None = None
        self._spec: Specification | None = None
        self._state: State | None = None
        if generator.system.is_discrete:
            if dt is not None and abs(dt - generator.dt) > 1e-9 * dt:
                raise ModelError(f"the generator has dt={generator.dt:g} s, dt={dt:g} s was given")
            self._use(generator)
        elif dt is not None:
            self._use(generator.discretize(dt))

    # ------------------------------------------------------------------- facts

    @property
    def generator(self) -> ResidualGenerator:
        """The sampled generator that runs."""
        if self._generator is None:
            raise ModelError(
                "the generator is continuous and the step of the recording is not known: "
                "Monitor(generator, dt=...), or give dt= or time= to fit or run"
            )
        return self._generator

    @property
    def is_fitted(self) -> bool:
        """Whether the monitor has a threshold, from data, from the noise model, or given."""
        return self._norm_test is not None

    @property
    def norm_test(self) -> NormTest:
        """The threshold test with every number filled in."""
        if self._norm_test is None:
            raise NotFittedError(
                "this monitor has no threshold: fit(u, y) it to fault-free data, give the plant noise "
                "(with_noise), or set NormThreshold(threshold=...)"
            )
        return self._norm_test

    @property
    def threshold(self) -> float:
        """The threshold on the norm of the whitened residual."""
        return self.norm_test.threshold

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """The faults, those that this monitor cannot tell apart in one group."""
        direction = self._specification().direction
        return direction.groups if direction else ()

    @property
    def settling_samples(self) -> int:
        """Samples after a start in which nothing is decided."""
        return settling_samples(self.generator) if self.settle is None else int(self.settle)

    # ----------------------------------------------------------------- fitting

    def fit(
        self,
        u: Any,
        y: ArrayLike | None = None,
        *,
        time: ArrayLike | None = None,
        dt: float | None = None,
        false_alarm_rate: float | None = None,
    ) -> Monitor:
        """Fit mean, covariance and threshold to a fault-free recording.

        Parameters
        ----------
        u : array_like, shape (time, inputs), or None
            Without ``y``: a data frame with named columns, or a :class:`residua.monitor.Recording`.
        y : array_like, shape (time, outputs)
            In plant units.
        time : array_like, shape (time,), optional
            Regular sample times in seconds.
        dt : float, optional
            Step, when ``time`` is not given and the generator is continuous.
        false_alarm_rate : float, optional
            Fraction of fault-free samples in alarm that is aimed at; that of the test when omitted.

        Returns
        -------
        Monitor
            Itself.

        Raises
        ------
        DataError
            If the recording does not fit the plant, or is too short.
        """
        rate = self.test.false_alarm_rate if false_alarm_rate is None else float(false_alarm_rate)
        check_rate(rate)
        given = signals(u, y, time, dt, "", self.design.plant)
        self._learn_step(given.dt)
        data = self._block(given.u, given.y)
        if len(data) != 1:
            raise DataError("fit takes one recording, (time, channels)")
        outputs = data[0, :, len(self.design.plant.inputs) :]
        if len(outputs) > 1 and not np.nanmax(np.ptp(np.where(np.isfinite(outputs), outputs, 0.0), axis=0)) > 0:
            raise DataError("no output ever changes in this recording: it cannot show what is normal")
        blank = NormTest(np.zeros(self.generator.n_residuals), np.eye(self.generator.n_residuals), np.inf, 1, 1, 1, "")
        _, found = run_block(self._specification(blank), initial_state(self._specification(blank), 1), data)
        self._norm_test = fit_norm_test(
            self.test,
            found.residuals[0],
            found.usable[0],
            false_alarm_rate=rate,
            covariance=self.generator.covariance_of_sums(self.test.window),
            signal_size=signal_size(self.generator, data[0] - self._specification(blank).offset),
        )
        self._spec = self._state = None
        return self

    # ----------------------------------------------------------------- running

    def run(
        self,
        u: Any,
        y: ArrayLike | None = None,
        *,
        time: ArrayLike | None = None,
        dt: float | None = None,
        source: str = "",
        progress: Callable[[int, int], None] | None = None,
    ) -> Diagnosis | list[Diagnosis]:
        """Run over a whole recording, from a fresh start.

        Parameters
        ----------
        u : array_like, shape (time, inputs) or (plants, time, inputs), or None
            Without ``y``: a data frame with named columns, or a :class:`residua.monitor.Recording`.
        y : array_like, shape (time, outputs) or (plants, time, outputs)
            In plant units.
        time : array_like, shape (time,), optional
            Regular sample times in seconds; counted from zero when omitted.
        dt : float, optional
            Step, when the generator is continuous and its step is not known yet.
        source : str
            Where the recording is from, for reports.
        progress : callable, optional
            Called with (samples done, samples in all).

        Returns
        -------
        Diagnosis
            A list of them, one per plant, for three-dimensional data.

        Notes
        -----
        The state afterwards is that at the end of the recording: :meth:`step` and :meth:`update` go on
        from there.
        """
        given = signals(u, y, time, dt, source, self.design.plant)
        self._learn_step(given.dt)
        data = self._block(given.u, given.y)
        spec = self._specification()
        self._state = initial_state(spec, len(data))
        parts: list[Decisions] = []
        for start in range(0, max(1, data.shape[1]), PIECE):
            self._state, part = run_block(spec, self._state, data[:, start : start + PIECE])
            parts.append(part)
            if progress is not None:
                progress(min(start + PIECE, data.shape[1]), data.shape[1])
        clock = self.generator.dt * np.arange(data.shape[1]) if given.time is None else given.time
        whole = [
            diagnosis_from(parts, p, clock, spec, self.generator, int(self._state.resets[p]), given.source, self.notes)
            for p in range(len(data))
        ]
        return whole if np.ndim(given.y) == 3 else whole[0]

    def update(self, u: ArrayLike | None, y: ArrayLike) -> Decisions:
        """Go on with a block of samples.

        Parameters
        ----------
        u : array_like, shape (time, inputs) or (plants, time, inputs), or None
        y : array_like, shape (time, outputs) or (plants, time, outputs)
            In plant units; NaN where a value is missing.

        Returns
        -------
        Decisions
            Arrays of (plants, time, ...): the same numbers as :meth:`run` over the whole would give.

        Raises
        ------
        DataError
            If the block does not fit the plant, or has another number of plants than the one before.
        """
        data = self._block(u, y)
        spec = self._specification()
        if self._state is None:
            self._state = initial_state(spec, len(data))
        if len(self._state.x) != len(data):
            raise DataError(
                f"the monitor follows {len(self._state.x)} plants, the block has {len(data)}; reset() first"
            )
        self._state, found = run_block(spec, self._state, data)
        return found

    def step(self, u: ArrayLike | None, y: ArrayLike) -> Decision:
        """Go on with one sample of one plant; the same answers as :meth:`run`, to the last bit.

        Parameters
        ----------
        u : array_like, shape (inputs,), or None
        y : array_like, shape (outputs,)

        Returns
        -------
        Decision
        """
        u_ = None if u is None else np.atleast_1d(np.asarray(u, dtype=float))[None]
        found = self.update(u_, np.atleast_1d(np.asarray(y, dtype=float))[None])
        alarm = bool(found.alarm[0, 0])
        return Decision(
            residual=found.residuals[0, 0],
            statistic=float(found.statistic[0, 0]),
            alarm=alarm,
            decided=bool(found.usable[0, 0]),
            missing=bool(found.missing[0, 0]),
            candidates=candidates_at(found.scores[0, 0], self.groups, self._dimensions()) if alarm else (),
        )

    def reset(self) -> None:
        """Forget all data seen so far; thresholds stay."""
        self._state = None

    def save(self, path: str | Path) -> None:
        """Write the monitor, its thresholds and its running state as JSON.

        Parameters
        ----------
        path : str or Path
            The file appears whole or not at all.

        Raises
        ------
        FileFormatError
            If the folder does not exist.
        """
        from residua.monitor.saving import save_monitor

        save_monitor(self, path)

    @staticmethod
    def load(path: str | Path) -> Monitor:
        """Read a monitor that :meth:`save` wrote; it goes on where it stopped, bit for bit."""
        from residua.monitor.saving import load_monitor

        return load_monitor(path)

    # ------------------------------------------------------------------ helpers

    def _dimensions(self) -> tuple[int, ...]:
        direction = self._specification().direction
        return direction.dimensions if direction else ()

    def _use(self, sampled: ResidualGenerator) -> None:
        self._generator = sampled
        self._norm_test = norm_test_from_model(
            self.test, sampled.covariance_of_sums(self.test.window), sampled.n_residuals
        )
        self._spec = self._state = None

    def _learn_step(self, dt: float | None) -> None:
        if dt is None:
            return
        if self._generator is None:
            self._use(self.design.discretize(dt))
        elif abs(dt - self._generator.dt) > 1e-3 * self._generator.dt:
            raise DataError(
                f"the monitor runs at dt={self._generator.dt:g} s, the recording has {dt:g} s: resample it, "
                "or design for this step"
            )

    def _block(self, u: ArrayLike | None, y: ArrayLike) -> NDArray[np.float64]:
        data = stack_signals(self.generator.plant, u, y)
        return data if data.ndim == 3 else data[None]

    def _specification(self, test: NormTest | None = None) -> Specification:
        if test is None and self._spec is not None:
            return self._spec
        chosen = self.norm_test if test is None else test
        g = self.generator
        n = g.system.n_states
        point = g.plant.operating_point
        direction = None
        if self.isolate is not None and test is None:
            direction = direction_test(
                self.isolate, g.subspaces, g.steady_directions, chosen.whitening, g.residual_rank
            )
        spec = Specification(
            g.system.A,
            g.system.B,
            g.system.C,
            g.system.D,
            np.asarray(np.linalg.solve(np.eye(n) - g.system.A, g.system.B), dtype=float),
            np.array([*point.inputs, *point.outputs]),
            chosen,
            direction,
            self.settling_samples,
            self.max_hold,
        )
        if test is None:
            self._spec = spec
        return spec

    def __repr__(self) -> str:
        state = f"threshold {self.threshold:.4g}" if self.is_fitted else "not fitted"
        return f"Monitor({self.design.method}, {self.design.plant.name!r}, {state})"
