"""Campaigns: a monitor on many simulated runs, with and without faults, on one core or several."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from residua.decide.checks import check_probability, check_samples, check_whole, is_number
from residua.errors import NotFittedError, SettingError, missing_extra
from residua.files import check_output
from residua.linear import StateSpace
from residua.monitor.monitor import Monitor
from residua.monitor.outcome import settings_of
from residua.plant import Plant
from residua.progress import Progress, progress_of
from residua.robust.sets.uncertain_plant import UncertainPlant
from residua.tolerances import SAME
from residua.validate.campaign_result import Campaign, CaseFacts, read_campaign
from residua.validate.given_signals import control_inputs, disturbance_signals
from residua.validate.intervals import CONFIDENCE
from residua.validate.noise import NoiseModel, Resampled, white
from residua.validate.runs import Plan, RunFigures, figures_of
from residua.validate.scenario import Scenario, cases_of
from residua.validate.shapes import StuckAt
from residua.validate.truth import Truth, check_same_channels, truth_of
from residua.visible import echo, listed

#: Seconds between two writings of the file that a campaign can be resumed from.
_SAVED_EVERY = 10.0
#: Numbers that one run may hold at once: half a gigabyte.
_MOST_NUMBERS = 6 * 10**7


def campaign(
    monitor: Monitor,
    scenarios: Scenario | Iterable[Scenario] = (),
    *,
    runs: int = 1000,
    samples: int = 5000,
    seed: int = 0,
    noise: NoiseModel | Resampled | None = None,
    inputs: Any = None,
    disturbances: Mapping[str, Any] | None = None,
    plants: Plant | Sequence[Plant] | UncertainPlant | None = None,
    controller: StateSpace | None = None,
    within: float | None = None,
    confidence: float = CONFIDENCE,
    workers: int = 1,
    resume: str | Path | None = None,
    progress: Progress | bool | None = None,
) -> Campaign:
    r"""Watch simulated runs with a monitor, and return its error rates, its delays, and the faults it names.

    Every run is simulated once without a fault, which gives the false alarms, and once for each scenario and size,

    .. math:: x_{k+1} = A x_k + B u_k + B_d d_k + B_f f_k + B_w w_k, \qquad
       y_k = C x_k + D u_k + D_d d_k + D_f f_k + D_w w_k

    from the operating point on, with the same noise: run ``k`` of one campaign and of another with the same seed have
    the same draws, which makes paired comparisons of monitors (:meth:`Campaign.compare`).

    Parameters
    ----------
    monitor : Monitor
        With a threshold. Its own state is not touched: every run starts afresh.
    scenarios : Scenario or sequence of Scenario
        Times in seconds after the first sample, as a :class:`residua.Diagnosis` counts them. Without any only false
        alarms are counted.
    runs, samples : int
        How many runs, and how many samples each, those included over which the monitor settles.
    seed : int
        Run ``k`` draws from children of ``numpy.random.SeedSequence(seed, spawn_key=(k,))``, so that nothing depends on
        how runs are put together, nor on the number of workers.
    noise : NoiseModel, Resampled, optional
        Noise for the plant's noise inputs: white Gaussian when omitted, :func:`coloured`, :func:`heavy_tailed`; or
        :func:`resampled` residuals in their place.
    inputs : number, array_like of shape (samples, inputs), Recording or data frame, optional
        Commands, in plant units, the same in every run; of a longer one the first samples. When omitted random levels,
        held for 25 samples on the average, that move the outputs ten times as far as the noise does; with a
        controller, nothing is added to its commands.
    disturbances : mapping of str to number, array_like or NoiseModel, optional
        By name; those that are not named are zero. A noise model is drawn by each run, with its own size.
    plants : Plant, sequence of Plant, or UncertainPlant, optional
        Simulated plant, if not the one that the monitor is designed for. Of several run ``k`` has number ``k``
        modulo their count; of an uncertain plant each run has a member of its own, drawn evenly from the box of
        parameters.
    controller : StateSpace, optional
        From outputs to inputs, as deviations, without a direct term: the simulation is of the closed loop, in which a
        faulty sensor misleads the controller too. (A monitor for a plant that *is* a closed loop needs none.)
    within : float, optional
        Seconds after the onset in which a detection counts; to the end of the run when omitted.
    confidence : float
        Of all intervals.
    workers : int
        Processes, by ``joblib`` where more than one; within ``joblib.parallel_config(backend=...)`` those of a cluster.
    resume : str or Path, optional
        A file to which runs are saved now and then. If it exists already the campaign continues from it.
    progress : callable, bool or None
        Told of (stage, runs done, runs in all); ``None``: a bar on terminals; ``False``: nothing.

    Returns
    -------
    Campaign

    Raises
    ------
    SettingError
        If the monitor knows no fault of that name, an onset is after the end of a run, a shape does not go with its
        fault, the plant has no noise, or the file to resume from is of another campaign.
    NotFittedError
        If the monitor has no threshold.
    ModelError
        If a plant is unstable without a controller, or the controller does not fit.
    DataError
        If inputs or disturbances are too short or not finite.
    MissingExtraError
        If several workers are asked for and ``joblib`` is not installed.

    Notes
    -----
    Assumes
        The plant is linear and sampled at the step of the monitor; a continuous one is sampled with inputs,
        disturbances and faults that are held over a step.

    Memory holds a few dozen bytes for each run and case, and the signals of some runs at a time.

    See Also
    --------
    Scenario : the fault, its shape and its size.
    load_scenarios : scenarios from a TOML file.

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
    >>> plant = plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)
    >>> monitor = rs.Monitor(rs.design.kalman_filter(plant), test=rs.decide.NormThreshold(false_alarm_rate=0.01))
    >>> stuck = rs.validate.Scenario("level sensor", rs.validate.step(at=100), size=0.6)
    >>> made = rs.validate.campaign(monitor, stuck, runs=200, samples=300, seed=1)
    >>> made.false_alarm_rate().value < 0.02, made.detected(0).value > 0.9
    (True, True)
    """
    check_probability(confidence, "confidence")
    check_samples(samples, "samples")
    for name, value, least in (("runs", runs, 1), ("workers", workers, 1), ("seed", seed, 0)):
        check_whole(value, name, least=least)
    plan, words = plan_of(
        monitor, scenarios, int(samples), int(seed), noise, inputs, disturbances, plants, controller, within
    )
    new = _empty_campaign(plan, monitor, int(runs), words, float(confidence))
    figures, done = RunFigures.empty(len(new.cases), new.runs), 0
    begun = None if resume is None else _begun(new, resume)
    if begun is not None:
        figures.put(0, begun)
        done = begun.runs
    step = plan.runs_at_once
    parts = [(first, min(first + step, new.runs)) for first in range(done, new.runs, step)]
    computed = (figures_of(plan, *part) for part in parts)
    if workers > 1:
        try:
            import joblib  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise missing_extra("joblib", "workers") from error
        calls = (joblib.delayed(figures_of)(plan, *part) for part in parts)
        computed = joblib.Parallel(n_jobs=int(workers), return_as="generator")(calls)
    tell, close = progress_of(progress)
    saved = time.monotonic()
    try:
        for part in computed:
            figures.put(done, part)
            done += part.runs
            if resume is not None and time.monotonic() - saved > _SAVED_EVERY:
                replace(new, figures=figures.first(done)).save(resume)
                saved = time.monotonic()
            tell("runs", done, new.runs)
    finally:
        close()
        if resume is not None:
            replace(new, figures=figures.first(done)).save(resume)
    return replace(new, figures=figures)


def _begun(new: Campaign, path: str | Path) -> RunFigures | None:
    """Return the figures of the runs already in a file, the beginning of the new campaign; ``None`` without one."""
    check_output(path)
    if not Path(path).exists():
        return None
    begun = read_campaign(path)
    if (begun.draws, begun.watched) != (new.draws, new.watched) or begun.figures.runs > new.runs:
        changed = [name for name, value in new.settings.items() if begun.settings.get(name) != value]
        if begun.watched != new.watched:
            changed.append("monitor")
        changed += [name for name in ("samples", "seed") if getattr(begun, name) != getattr(new, name)]
        if begun.figures.runs > new.runs:
            changed.append(f"runs, of which it has {begun.figures.runs:,}")
        raise SettingError(
            f"{echo(str(path))} holds another campaign (different: {listed(changed) if changed else 'runs'}): name "
            "another file, or remove that one"
        )
    return begun.figures


def plan_of(
    monitor: Monitor,
    scenarios: Scenario | Iterable[Scenario],
    samples: int,
    seed: int,
    noise: NoiseModel | Resampled | None,
    inputs: Any,
    disturbances: Mapping[str, Any] | None,
    plants: Any,
    controller: StateSpace | None,
    within: float | None,
) -> tuple[Plan, dict[str, str]]:
    """Return the plan of the runs, and its description."""
    if not isinstance(monitor, Monitor):
        raise SettingError(f"a campaign takes a Monitor, got {type(monitor).__name__}")
    if not monitor.is_fitted:
        raise NotFittedError("this monitor has no threshold: fit it, or give its plant noise, before a campaign")
    generator, spec = monitor.generator, monitor._specification()
    dt = generator.dt
    truths, uncertain, about_plant, simulated = _truths(monitor.design.plant, plants, dt, controller, samples)
    cases = cases_of(scenarios, monitor.design.plant, samples, dt)
    lacking = [case.fault for case in cases if case.fault not in truths[0].faults]
    if lacking:
        raise SettingError(f"the simulated plant has no fault {echo(lacking[0])}")
    one = truths[0]
    wide = samples * (one.B.shape[1] + 4 * spec.B.shape[1] + 8 * len(spec.C) + len(spec.isolation.groups))
    if wide > _MOST_NUMBERS:
        raise SettingError(
            f"one run of {samples:,} samples takes {wide * 8 / 2**30:.1f} GB: fewer samples, and more runs instead"
        )
    seeds = np.random.SeedSequence(seed)
    u, about_inputs = control_inputs(inputs, one, generator.plant.inputs, samples, seeds)
    d, drawn, about_disturbances = disturbance_signals(disturbances, simulated.disturbances, samples)
    chosen = _noise(noise, one, spec, bool(disturbances))
    if within is not None and not (is_number(within) and within >= dt):
        raise SettingError(f"within must be one step ({dt:g} s) or more, in seconds, got {echo(within)}")
    counted = samples if within is None else round(within / dt)
    late = [case for case in cases if within is not None and case.shape.latest_sample(dt) + counted > samples]
    if late:
        raise SettingError(
            f"scenario {echo(late[0].fault)}: the run ends before the {within:g} s are over in which a detection "
            f"counts, after an onset at {late[0].shape.latest:g} s: an earlier onset, a shorter within=, more samples"
        )
    plan = Plan(
        spec,
        generator,
        () if uncertain else truths,
        uncertain,
        controller,
        cases,
        samples,
        seed,
        u,
        d,
        drawn,
        chosen,
        counted,
        one.offset,
    )
    words = {
        "plant": about_plant,
        "noise": "none" if chosen is None else str(chosen),
        "inputs": about_inputs,
        "disturbances": about_disturbances,
        "controller": "none" if controller is None else f"{controller.n_states} states, in the loop",
        "a detection counts": "to the end of the run" if within is None else f"within {within:g} s of the onset",
    }
    return plan, words


def _noise(
    noise: NoiseModel | Resampled | None, truth: Truth, spec: Any, disturbed: bool
) -> NoiseModel | Resampled | None:
    """Return the noise that is drawn for every run."""
    if isinstance(noise, Resampled):
        if noise.residuals.shape[1] != len(spec.C):
            raise SettingError(
                f"the resampled residuals have {noise.residuals.shape[1]} columns, the monitor's generator has "
                f"{len(spec.C)} residuals: take those of the same monitor"
            )
        return noise
    if noise is not None and not isinstance(noise, NoiseModel):
        raise SettingError(f"noise must be white(), coloured(), heavy_tailed() or resampled(), got {echo(noise)}")
    if noise is not None and noise.size != 1:
        raise SettingError("the plant gives the size of its noise (with_noise): leave out the size of the noise model")
    if truth.noises:
        return white() if noise is None else noise
    if noise is not None or not disturbed:
        raise SettingError(
            "the plant has no noise to simulate: plant.with_noise(process=..., measurement=...), or "
            "noise=rs.validate.resampled(residuals) of fault-free recordings"
        )
    return None


def _truths(
    model: Plant, plants: Any, dt: float, controller: StateSpace | None, samples: int
) -> tuple[tuple[Truth, ...], UncertainPlant | None, str, Plant]:
    """Return the plants to simulate, an uncertain plant if there is one, a description, and the first of the plants."""
    uncertain = plants if isinstance(plants, UncertainPlant) else None
    if plants is None:
        several, about = [model], "that of the monitor"
    elif uncertain is not None:
        several, about = [uncertain.nominal], f"a member of {uncertain!r} for each run"
    elif isinstance(plants, Plant):
        several, about = [plants], repr(plants)
    elif isinstance(plants, (list, tuple)):
        several, about = list(plants), f"{len(plants)} plants in turn"
    else:
        several, about = [], ""
    if not several or not all(isinstance(one, Plant) for one in several):
        raise SettingError(f"plants must be a Plant, several of them, or an UncertainPlant, got {echo(plants)}")
    first = several[0]
    for one in several:
        check_same_channels(one, model)
        if one.is_discrete and abs(one.dt - dt) > SAME * dt:
            raise SettingError(f"plant {one.name!r} has dt={one.dt:g} s, the monitor runs at {dt:g} s")
        alike = [(p.disturbances, p.faults, p.Bw.shape[1]) for p in (one, first)]
        if alike[0] != alike[1]:
            raise SettingError("the plants must have the same disturbances, faults and number of noises")
    return tuple(truth_of(one, dt, controller, samples) for one in several), uncertain, about, first


def _empty_campaign(plan: Plan, monitor: Monitor, runs: int, words: dict[str, str], confidence: float) -> Campaign:
    """Return the campaign without its runs."""
    cases = tuple(
        CaseFacts(one.fault, str(one.shape), np.nan if isinstance(one.shape, StuckAt) else one.size, one.scenario)
        for one in plan.cases
    )
    spec, loop = plan.spec, plan.controller
    draws = digest(
        *(plan.truths, plan.uncertain, loop and loop.A, loop and loop.B, loop and loop.C, plan.cases, plan.samples),
        *(plan.seed, plan.inputs, plan.disturbances, plan.drawn, plan.noise, plan.within, plan.generator.dt),
    )
    try:
        own_version = metadata.version("residua")
    except metadata.PackageNotFoundError:
        own_version = "unknown"
    software = {"residua": own_version, "NumPy": np.__version__, "SciPy": scipy.__version__}
    versions = {f"version of {name}": version for name, version in software.items()}
    return Campaign(
        plant=monitor.design.plant.name,
        cases=cases,
        groups=spec.isolation.groups,
        figures=RunFigures.empty(len(cases), 0),
        runs=runs,
        samples=plan.samples,
        seed=plan.seed,
        dt=plan.generator.dt,
        threshold=float(spec.test.threshold),
        window=spec.test.samples,
        settling=spec.settle,
        settings=words | settings_of(spec, plan.generator) | versions,
        draws=draws,
        watched=digest(spec),
        confidence=confidence,
    )


def digest(*values: Any) -> str:
    """Return a digest that depends on all settings, matrices and signals."""
    sha = hashlib.sha256()
    for value in values:
        _feed(sha, value)
    return sha.hexdigest()


def _feed(sha: Any, value: Any) -> None:
    """Feed a value: arrays by their bytes, dataclasses and containers by their parts, anything else by its text."""
    if isinstance(value, np.ndarray):
        sha.update(f"{value.dtype}{value.shape}".encode())
        sha.update(np.ascontiguousarray(value).tobytes() if value.dtype != object else repr(value.tolist()).encode())
    elif is_dataclass(value) and not isinstance(value, type):
        sha.update(type(value).__qualname__.encode())
        for one in fields(value):
            sha.update(one.name.encode())
            _feed(sha, getattr(value, one.name))
    elif isinstance(value, Mapping):
        _feed(sha, list(value.items()))
    elif isinstance(value, (list, tuple)):
        sha.update(f"{len(value)}[".encode())
        for one in value:
            _feed(sha, one)
    elif isinstance(value, (str, int, float, complex, bool, bytes, np.generic)) or value is None:
        sha.update(repr(value).encode())
    else:
        sha.update(getattr(value, "__qualname__", type(value).__qualname__).encode())
