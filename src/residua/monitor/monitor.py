"""A residual generator with its decision logic, running on data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.decide.checks import check_rate, check_samples
from residua.decide.isolation import IsolationSettings, NoIsolation
from residua.decide.learnt_faults import LearntFault
from residua.decide.test import ResidualTest, TestSettings, Watched
from residua.design import ResidualGenerator
from residua.design.core.generator import as_generator
from residua.design.core.signals import stacked
from residua.errors import DataError, ModelError, NotFittedError, SettingError
from residua.monitor.decision import Decision, decision_from
from residua.monitor.diagnosis import Diagnosis
from residua.monitor.fault_learning import (
    LearntFaults,
    checked_name,
    learnt_from_blocks,
    learnt_table,
    with_faults,
)
from residua.monitor.fit_check import FitCheck
from residua.monitor.fitted_thresholds import check_held_out, fitted_test
from residua.monitor.inputs import Signals, plant_signals, settling_samples, several_signals, signals
from residua.monitor.online import Online, checked_keep, own_lock, run_whole
from residua.monitor.outcome import Recorded, compared_outputs, diagnosis_from, settings_of
from residua.monitor.plausible_values import (
    TIMES,
    Plausible,
    checked_plausible,
    fitted_ranges,
    guarded_ranges,
    plausible_deviations,
)
from residua.monitor.running import Decisions, State
from residua.monitor.specification import (
    Specification,
    blank_test,
    brought_bounds,
    check_windows,
    chosen_isolation,
    chosen_test,
    specification,
    with_estimator,
)
from residua.monitor.start_estimate import checked_start
from residua.shown import Shown, table
from residua.tolerances import SAME
from residua.wrong_guesses import Guessed, guessed


class Monitor(Guessed, Shown):
    """Watches recorded or live data for faults.

    Data are in plant units: the plant's operating point is subtracted inside. A continuous generator is sampled at
    ``dt``. Missing values (NaN, infinity) never end a run: the last value of that channel is held for the filter, no
    residual is reported on that sample, and nothing is decided until the filter has settled again; after more than
    ``max_hold`` incomplete samples in a row the filter restarts with the next complete sample. A stationary Kalman
    filter uses the values that are present instead, by the exact gain for them: nothing is decided on the incomplete
    sample itself, and everything on the next one. A missing input is treated as unknown; its effect is estimated from
    the outputs. Samples without a usable output (none is present, or a missing input acts on all of them at once) count
    towards ``max_hold`` there. An implausible value (``plausible``) is missing too, and is counted; if the state of the
    filter still overflows, it restarts, which is counted. The initial state is estimated (``start``), so that the plant
    need not be at rest then.

    Parameters
    ----------
    generator : ResidualGenerator, or a bank, matched filters or an estimator
        Of an object that is not a generator itself, its ``generator`` is run.
    test : NormThreshold, PeakThreshold or TestSettings, optional
        When to raise an alarm. When omitted, for a design that brings certified thresholds (its ``thresholds``, one for
        each member) :class:`residua.decide.PeakThreshold` with those, for one that brings a test that it is made for
        (its ``test``) that one, for any other :class:`residua.decide.MultiscaleEWMA`, a bank of means.
    isolate : Directional, Structured, Matched, IsolationSettings, None or "auto"
        How to name the fault. With :class:`residua.decide.Structured` every member of a bank has its own
        whitening, threshold and alarm, each with its share of the false alarm rate; the monitor is in alarm while
        any member is, and the fault is read from which of them are. With :class:`residua.decide.Matched` the fault,
        its arrival and its size are those whose expected response explains white residuals best; otherwise the fault is
        named by direction, or not at all (``None``). ``"auto"``: by code for a bank, by responses for matched filters,
        by direction for any other generator.
    estimator : ResidualGenerator, or an estimator, optional
        Beside a bank, which names the fault: a fault estimator of the same plant, which tells its size
        (:attr:`residua.Diagnosis.estimates`). It runs on the same data and takes no part in alarms.
    dt : float, optional
        Step in seconds at which a continuous generator is sampled; may also come from the recording that
        is fitted.
    settle : int, optional
        Samples after a start or a gap in which nothing is decided. By default until the slowest pole of the filter
        has decayed to 1 %; to a millionth, which takes three times as long, if the thresholds of
        :class:`residua.decide.PeakThreshold` are certified or set by the user: no certified threshold covers the
        effect of a start or a held value on the residual. Fewer samples decide earlier, at that price.
    max_hold : int
        Longest gap in samples that is bridged by holding values.
    plausible : float, mapping of str to (float, float), or None
        Values outside are missing: marks for "no value" such as ``1e300``, not faults. A number: each channel from the
        middle of the recording that was fitted up to so many times its size there (its range, or its largest absolute
        value where that is more). A mapping: the smallest and largest value of the channels that it names, in plant
        units; the others as by default. ``None``, or without a recording: only values that would move the residual by
        more than 1e30 standard deviations (thresholds of :class:`residua.decide.PeakThreshold`) is missing. A sensor
        that fails to an end of its scale must stay within: missing values raise no alarm.
    start : {"estimated", "rest"}
        How the filter finds its state after a start, and after a gap longer than ``max_hold``. ``"rest"``: as if the
        plant had been at rest at the first sample; the error of that decays, to 1 % at most after ``settle`` samples.
        ``"estimated"``: in addition, its least-squares estimate from the residuals of these samples (2,000 at most) is
        removed from the state after them. A fault present from the first sample on is partly removed with it, as far as
        its residual looks like that of a wrong start. Thresholds that are bounds,
        certified or set by the user, hold from rest, or once every start has died away: there a start is always from
        rest. The notes of a diagnosis say where the estimate moved the residual by more than a tenth of its threshold.

    Notes
    -----
    Threads: :meth:`run` works on a state of its own, so one monitor may run several recordings at once in several
    threads; :meth:`step` then continues from the end of the one that finished last. :meth:`update` and
    :meth:`step` belong to one stream of data: calls from several threads are done one after the other, each complete,
    but the order of samples is the caller's to keep. Give each stream a monitor of its own
    (``copy.deepcopy(monitor)`` shares nothing that changes). :meth:`fit` waits for samples of a stream, they for it.

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

    @guessed("Monitor")
    def __init__(
        self,
        generator: Any,
        *,
        test: TestSettings | None = None,
        isolate: IsolationSettings | str | None = "auto",
        estimator: Any = None,
        dt: float | None = None,
        settle: int | None = None,
        max_hold: int = 10,
        plausible: Plausible = TIMES,
        start: str = "estimated",
    ) -> None:
        design, generator = generator, as_generator(generator)
        if estimator is not None:
            generator = with_estimator(generator, as_generator(estimator))
        if settle is not None:
            check_samples(settle, "settle", least=0)
        check_samples(max_hold, "max_hold", least=0)
        self.design: ResidualGenerator = generator
        self._isolation = chosen_isolation(isolate, generator, design)
        self.test, self._certified = chosen_test(test, design, generator, self._isolation)
        self._settings = self._isolation.test_of(self.test)
        check_windows(self._settings, self._isolation, self._watched(generator))
        self._bounds = brought_bounds(design, generator)
        if estimator is not None and self._isolation.parts(generator) is None:
            raise SettingError("an estimator runs beside a bank that is read by code: use a bank, and Structured()")
        self.settle = settle
        self.max_hold = int(max_hold)
        self.plausible = checked_plausible(plausible, (*generator.plant.inputs, *generator.plant.outputs))
        self.start = checked_start(start)
        self._ranges: NDArray[np.float64] | None = None
        self.notes: tuple[str, ...] = ()
        self._generator: ResidualGenerator | None = None
        self._test: ResidualTest | None = None
        self._check: FitCheck | None = None
        self._spec: Specification | None = None
        self._learnt: tuple[LearntFault, ...] = ()
        self._normal: NDArray[np.float64] | None = None
        self._running: tuple[Specification, Specification] | None = None
        self._online = Online(len(generator.plant.inputs))
        self._lock = own_lock(self)
        if generator.system.is_discrete:
            if dt is not None and abs(dt - generator.dt) > SAME * dt:
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
        """True if the monitor has a threshold: from data, from the noise model, or from the user."""
        return self._test is not None

    @property
    def isolate(self) -> IsolationSettings | None:
        """Settings of the isolation; ``None`` for none."""
        return None if isinstance(self._isolation, NoIsolation) else self._isolation

    @property
    def norm_test(self) -> Any:
        """The fitted test; for a bank, those of all its members."""
        if self._test is None:
            raise NotFittedError(f"this monitor has no threshold: {self._settings.remedy}")
        return self._test

    @property
    def threshold(self) -> float:
        """The threshold on the statistic: 1 for a bank, whose members have their own (``norm_test.thresholds``)."""
        return self.norm_test.threshold

    @property
    def false_alarm_rate(self) -> float:
        """Target fraction of fault-free samples in alarm: by the last fit; before one by the test, or 1e-4."""
        if self._check is not None and self._check.aimed is not None:
            return self._check.aimed
        return self._settings.asked(self._watched(self.generator))

    @property
    def fit_check(self) -> FitCheck | None:
        """Check of the last fit on its own recordings; ``None`` without a fit."""
        return self._check

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """The faults, indistinguishable ones in one group.

        A fault that some members of a bank see only while it changes is in two: see :class:`residua.decide.CodeTest`.
        """
        return self._specification().isolation.groups

    @property
    def settling_samples(self) -> int:
        """Number of samples after a start without a decision."""
        if self._test is not None:
            return self._specification().settle  # of a loaded monitor that with which it was saved
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
        held_out: float = 0.2,
        transient: int | str = 0,
        force: bool = False,
    ) -> Monitor:
        """Fit mean, covariance and threshold to one or several fault-free recordings.

        The last fifth of every recording is held out: used neither for the covariance nor for the threshold.
        ``monitor.fit_check`` has the rate of false alarms, and the alarms among these samples. Where they contradict
        the rate aimed at, or residuals change within a recording, every diagnosis has a note with the remedy.

        Several (flights, days, batches) each have a start of their own, over which the filter settles. A finite-horizon
        test has thresholds alone. A fit does not change thresholds that are certified or set by the user: it compares
        the recording with them, for ``norm_test.basis``.

        Parameters
        ----------
        u : array_like, shape (time, inputs), or None
            Without ``y``: a data frame with named columns, a :class:`residua.monitor.Recording`, the path of a file
            (as :func:`residua.read_recording` reads it for the plant), or a list of recordings: these, or pairs
            ``(u, y)``. A generator of recorded channels, which reads all of them as outputs, takes them in ``y``, or as
            they were: inputs in ``u`` and outputs in ``y``.
        y : array_like, shape (time, outputs)
            In plant units.
        time : array_like, shape (time,), optional
            Regular sample times in seconds.
        dt : float, optional
            Step, for a continuous generator without ``time``.
        false_alarm_rate : float, optional
            Fraction of fault-free samples in alarm aimed at; when omitted that of the test, or 5 / rows, 1e-4 to 1e-2.
        held_out : float
            Last part of the usable samples of each recording, which only checks the fit; none where that would be under
            thirty samples or two windows of the test. After the check, a fit with ``held_out=0`` uses all samples.
        transient : int or "auto"
            Samples at the start of each recording, counted with those over which the filter settles, that the fit
            leaves out. ``"auto"``: those over which the norm of the residuals is larger than in the rest
            (:func:`residua.decide.stationarity.changes`), half of the recording at most. Starts raise alarms then.
        force : bool
            Fit recordings that look faulty, too (``fit_check.looks_faulty``).

        Returns
        -------
        Monitor
            Itself.

        Raises
        ------
        DataError
            If a recording does not fit the plant, is too short, looks faulty, or is over a finite-horizon threshold.
        """
        check_held_out(held_out, transient)
        parts = several_signals(u, y, time, dt, self.design.plant)
        with self._lock:
            for one in parts:
                self._learn_step(one.dt)
            check_rate(false_alarm_rate)
            recordings = [self._block(one.u, one.y) for one in parts]
            blank = blank_test(self.generator)
            samples = np.concatenate([data.reshape(-1, data.shape[2]) for data in recordings])
            ranges = fitted_ranges(self.plausible, samples, guarded_ranges(self.generator, blank))
            test, check, normal = fitted_test(
                self._settings,
                self._watched(self.generator),
                recordings,
                false_alarm_rate,
                settle=self.settle,
                max_hold=self.max_hold,
                plausible=self._limits(ranges, blank),
                start=self.start,
                held_out=float(held_out),
                transient=transient,
            )
            if not force:
                check.require_fault_free()
            fitted = {"_test": test, "_check": check, "_normal": normal, "_ranges": ranges}
            vars(self).update(fitted, _spec=None, _online=Online(self._online.inputs))  # all at once
        return self

    # ---------------------------------------------------------------- learning

    def learn_fault(
        self,
        name: str,
        u: Any,
        y: ArrayLike | None = None,
        *,
        interval: Any = None,
        time: ArrayLike | None = None,
        dt: float | None = None,
    ) -> Monitor:
        r"""Learn a fault from one labelled recording of it, or from several; diagnoses name it from then on.

        Where faults are named by direction, or not at all, the direction of its residual is learnt,

        .. math:: \hat d = \frac{\bar q}{\|\bar q\|}, \qquad q_k = W^T (r_k - \bar r_{normal}),

        the mean of the whitened residual while the fault is there, with a cone that holds the true direction with 95 %
        confidence: from the scatter of the residual, its samples counted for as many independent ones as they are
        worth, and from the spread between recordings; the larger governs. An alarm is put down to it where the residual
        is no further off that direction than the cone and the noise of the window account for, whatever the size and
        sign of the fault; where that is so for none, and no fault of the model explains it well, it is an *unknown
        fault*. In a bank that is read by code it is the code: which members fire.

        Parameters
        ----------
        name : str
            A fault of that name that was learnt before is learnt anew.
        u : array_like, shape (time, inputs), or None
            Without ``y``: a data frame, a :class:`residua.monitor.Recording`, a path, or a list of recordings, as for
            :meth:`fit`. Several occurrences say more than a long one.
        y : array_like, shape (time, outputs)
            In plant units.
        interval : (float, float), ndarray of bool, or a list of these, optional
            When the fault was there: from a time to before another, in seconds on the clock of the recording
            (``np.inf``: to its end), or a mask of samples; one for all recordings or one for each. When omitted, from
            the first alarm on.
        time : array_like, shape (time,), optional
        dt : float, optional

        Returns
        -------
        Monitor
            Itself. Its running state restarts. A later :meth:`fit` keeps the learnt faults.

        Raises
        ------
        DataError
            If a recording raises no alarm and no interval is given, does not differ from fault-free data, or shows a
            direction with a cone wider than 60 degrees.
        SettingError
            If the monitor names by matched filters.
        NotFittedError
            If the monitor has no threshold, or does not know the covariance of fault-free residuals.

        Notes
        -----
        Assumes: the fault moves the residual along one line; changes over the interval count as scatter, and
        widens the cone. One recording does not say how much one occurrence differs from the next, and the diagnosis
        says so.

        See Also
        --------
        learnt_faults : the table of learnt faults, with angles to the predictions of the model.

        References
        ----------
        Mardia and Jupp (2000), Directional statistics, section 10.4. Yoon and MacGregor (2001), Journal of Process
        Control 11(4), 387-400 (fault signatures from past occurrences, and angles between them).

        Examples
        --------
        >>> import numpy as np
        >>> import residua as rs
        >>> rng = np.random.default_rng(0)
        >>> normal = rng.standard_normal((600, 3))
        >>> made = rs.identify.principal_components(normal[:300], outputs=["flow", "speed", "pressure"])
        >>> monitor = rs.Monitor(made).fit(None, normal[300:])
        >>> leak = rng.standard_normal((200, 3)) + [4.0, -3.0, 0.0]
        >>> monitor.learn_fault("leak", None, leak).run(None, rng.standard_normal((100, 3)) + [8.0, -6.0, 0.0]).named
        (('leak',),)
        """
        name = checked_name(name)
        parts = several_signals(u, y, time, dt, self.design.plant)
        with self._lock:
            for one in parts:
                self._learn_step(one.dt)
            plain = self._plain_specification()
            blocks = [self._block(one.u, one.y) for one in parts]
            settings = self.generator.dt, plain, self._isolation, self._normal
            made = learnt_from_blocks(name, [one.time for one in parts], blocks, interval, *settings)
            faults = (*(fault for fault in self._learnt if fault.name != name), made)
            with_faults(plain, faults, self._normal, self._isolation)  # raises where it does not go with the others
            vars(self).update(_learnt=faults, _running=None, _online=Online(self._online.inputs))
        return self

    @property
    def learnt_faults(self) -> LearntFaults:
        """The faults that were learnt from recordings: a table to print, with a :class:`LearntRow` for each."""
        return learnt_table(self._specification().isolation) if self._learnt else LearntFaults()

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
            Without ``y``: a data frame with named columns, a :class:`residua.monitor.Recording`, or the path of a file;
            otherwise as for :meth:`fit`.
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
        from there. Until then the state of the monitor is not touched, so that several threads may run at once.
        """
        return self._judge(signals(u, y, time, dt, source, self.design.plant), progress)

    def _judge(
        self,
        measured: Signals,
        progress: Callable[[int, int], None] | None = None,
        own: NDArray[np.bool_] | None = None,
    ) -> Diagnosis | list[Diagnosis]:
        """Run over a recording; ``own``: the samples for this monitor to judge, if others judge the rest."""
        self._learn_step(measured.dt)
        checked = plant_signals(measured.u, measured.y, self.generator.plant)
        with self._lock:
            generator, spec, check, notes = self.generator, self._specification(), self._check, self.notes
        state, decisions, data = run_whole(spec, *checked, progress)
        self._go_on_from(state, spec)
        clock = np.arange(data.shape[1], dtype=float) if measured.time is None else measured.time
        if measured.time is None:
            clock *= generator.dt
        compared = compared_outputs(self.design)
        notes = (*notes, *(check.notes if check else ()), *measured.notes)
        whole = []
        for p in range(len(data)):
            recorded = Recorded(clock, data[p], measured.source, measured.origin, compared, own)
            known = state.filter, p, notes, self._bounds, check
            whole.append(diagnosis_from(decisions.of(p), recorded, spec, generator, *known))
        return whole if np.ndim(measured.y) == 3 else whole[0]

    def run_file(
        self,
        path: str | Path,
        *,
        residuals: str | Path | None = None,
        alarms: str | Path | None = None,
        report: str | Path | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Diagnosis:
        """Run over a file that may be larger than memory, from a fresh start: the alarms and notes of :meth:`run`.

        Table, alarms and page are written where they are asked for, each whole or not at all. The series of the
        diagnosis are thinned. See :func:`residua.monitor.streaming.run_file` for arguments, errors and an example.
        """
        from residua.monitor.streaming import run_file

        return run_file(self, path, residuals=residuals, alarms=alarms, report=report, progress=progress)

    def update(self, u: ArrayLike | None, y: ArrayLike, *, keep: Sequence[str] | None = None) -> Decisions:
        """Process a block of samples.

        Parameters
        ----------
        u : array_like, shape (time, inputs) or (plants, time, inputs), or None
        y : array_like, shape (time, outputs) or (plants, time, outputs)
            In plant units; NaN where a value is missing.
        keep : sequence of str, optional
            Wanted fields of the decisions, such as ``("alarm", "statistic")``: the rest is ``None``, and is not
            written. All when omitted.

        Returns
        -------
        Decisions
            Arrays of (plants, time, ...): the same numbers as :meth:`run` over the whole would give.

        Raises
        ------
        DataError
            If the block does not fit the plant, or has another number of plants than the one before.
        """
        names, data = checked_keep(keep), self._block(u, y)
        with self._lock:
            return self._online.go_on(self._specification(), data, names)[0]

    def step(self, u: ArrayLike | None, y: ArrayLike) -> Decision:
        """Process one sample of one plant; the same answers as :meth:`run`, to the last bit.

        Parameters
        ----------
        u : array_like, shape (inputs,), or None
        y : array_like, shape (outputs,)

        Returns
        -------
        Decision
        """
        with self._lock:
            known = self._running  # as a rule; a call for it takes a tenth of the time
            spec = known[1] if known is not None and known[0] is self._spec else self._specification()
            quick = self._online.step(spec, self.generator, u, y)
            if quick is not None:
                return quick
            u_ = None if u is None else np.atleast_1d(np.asarray(u, dtype=float))[None]
            data = self._block(u_, np.atleast_1d(np.asarray(y, dtype=float))[None])
            decisions, state = self._online.go_on(spec, data)
        return decision_from(decisions, spec, self.generator, state)

    def reset(self) -> None:
        """Forget all data seen so far; thresholds stay."""
        with self._lock:
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

        with self._lock:
            save_monitor(self, path)

    @staticmethod
    def load(path: str | Path) -> Monitor:
        """Read a monitor saved by :meth:`save`; it continues where it stopped, bit for bit.

        Parameters
        ----------
        path : str or Path

        Returns
        -------
        Monitor

        Raises
        ------
        FileFormatError
            If the file is not a monitor, an entry is missing, unknown or invalid (the message names it), or the
            content was changed, by its checksum. A file that was edited on purpose declares it by
            ``"checksum": null``; its monitor then says so in every diagnosis.
        """
        from residua.monitor.saving import load_monitor

        return load_monitor(path)

    # ------------------------------------------------------------------ helpers

    @property
    def _state(self) -> State | None:
        return self._online.state

    @_state.setter
    def _state(self, state: State | None) -> None:
        self._online.state = state

    def _go_on_from(self, state: State, spec: Specification) -> None:
        """Let the next sample follow a recording, unless thresholds or faults have changed while it ran."""
        with self._lock:
            if self._specification() is spec:
                self._state = state

    def __getstate__(self) -> dict[str, Any]:
        """Return the content of a copy, which gets its own lock and state, all taken between two blocks."""
        with self._lock:
            return {**self.__dict__, "_lock": None, "_online": self._online.apart()}

    def __setstate__(self, content: dict[str, Any]) -> None:
        """Restore everything but the lock."""
        vars(self).update(content)
        self._lock = own_lock(self)

    def _watched(self, generator: ResidualGenerator) -> Watched:
        return Watched(generator, self._isolation.parts(generator), self._certified)

    def _use(self, sampled: ResidualGenerator) -> None:
        self._generator = sampled
        self._test, self._check = self._settings.from_model(self._watched(sampled)), None
        self._spec = self._state = None

    def _learn_step(self, dt: float | None) -> None:
        if dt is None:
            return
        with self._lock:
            if self._generator is None:
                self._use(self.design.discretize(dt))
        if abs(dt - self.generator.dt) > 1e-3 * self.generator.dt:
            raise DataError(
                f"the monitor runs at dt={self.generator.dt:g} s, the recording has {dt:g} s: resample it, "
                "or design for this step"
            )

    def _block(self, u: ArrayLike | None, y: ArrayLike) -> NDArray[np.float64]:
        return stacked(*plant_signals(u, y, self.generator.plant))

    def _specification(self) -> Specification:
        """Return the specification, with the learnt faults."""
        with self._lock:
            plain = self._plain_specification()
            if self._running is None or self._running[0] is not plain:
                self._running = (plain, with_faults(plain, self._learnt, self._normal, self._isolation))
            return self._running[1]

    def _plain_specification(self) -> Specification:
        """Return the specification, without learnt faults."""
        with self._lock:
            if self._spec is None:
                self._spec = specification(
                    self.generator,
                    self.norm_test,
                    self._isolation,
                    settle=self.settle,
                    max_hold=self.max_hold,
                    plausible=self._limits(self._ranges, self.norm_test),
                    start=self.start,
                )
            return self._spec

    def _limits(self, ranges: NDArray[np.float64] | None, test: ResidualTest) -> NDArray[np.float64]:
        plant = self.generator.plant
        return plausible_deviations(self.plausible, (*plant.inputs, *plant.outputs), ranges, self.generator, test)

    def _headline(self) -> str:
        state = f"threshold {self.threshold:.4g}" if self.is_fitted else "not fitted"
        return f"{self.design.method}, {self.design.plant.name!r}, {state}"

    def _parts(self) -> list[str]:
        rows = settings_of(self._specification(), self.generator).items() if self.is_fitted else ()
        return [table(["setting", ""], rows), *(self._check._parts() if self._check else ())]
