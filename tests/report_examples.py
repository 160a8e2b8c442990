"""Diagnoses made by hand for the tests of the report: small plants, plain observers, known outcomes."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np

from residua.decide import Directional, whitening_matrix
from residua.decide.alarm import Alarm, Candidate
from residua.decide.directional import direction_test
from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator, make_generator
from residua.linear import StateSpace
from residua.linear.subspaces.rank import decide_rank
from residua.monitor.diagnosis import Diagnosis
from residua.monitor.diagnosis_facts import NamingFacts, RecordingFacts, ThresholdFacts
from residua.plant import Plant


def generator(n: int = 3, *, names: list[str] | None = None, noise: bool = False, dt: float = 0.1) -> ResidualGenerator:
    """An observer of ``n`` coupled first-order systems, every state measured."""
    A = 0.7 * np.eye(n) + 0.15 * np.eye(n, k=1)
    outputs = names or [f"level {i + 1}" for i in range(n)]
    plant = Plant(
        A,
        np.ones((n, 1)),
        np.eye(n),
        dt=dt,
        inputs=["pump"],
        outputs=outputs,
        name="tanks",
        units=dict.fromkeys(outputs, "m"),
    )
    plant = plant.with_sensor_faults().with_actuator_faults()
    if noise:
        plant = plant.with_noise(process=1e-4 * np.eye(n), measurement=1e-3 * np.eye(n))
    K = A - 0.4 * np.eye(n)
    system = StateSpace(
        A - K,
        np.hstack([plant.B, K]),
        -np.eye(n),
        np.hstack([np.zeros((n, 1)), np.eye(n)]),
        dt=dt,
        outputs=[f"r {name}" for name in outputs],
    )
    evidence = Evidence(
        "full-order observer",
        poles=np.linalg.eigvals(A - K).astype(complex),
        requested_poles=np.full(n, 0.4 + 0j),
        decoupling={"control": 3.1e-16},
        ranks={"observability": decide_rank(np.eye(n)), "rank [C; CA]": decide_rank(np.diag([1.0] * n + [0.0]))},
        conditions={"eigenvectors": 1.0},
        notes=("the poles were asked for",),
        references=("Chen, Patton and Zhang (1996), eqs. (2) to (8)",),
    )
    return make_generator(
        system, plant, "full-order observer", evidence, decouples=Decoupled(disturbances=False), state_map=np.eye(n)
    )


def diagnosis(
    n_samples: int = 600,
    *,
    gen: ResidualGenerator | None = None,
    fault: bool = True,
    seed: int = 0,
    **changes: Any,
) -> Diagnosis:
    """A recording with a bias on the second sensor in its last half."""
    gen = gen or generator()
    rng = np.random.default_rng(seed)
    n, dt = gen.n_residuals, gen.dt
    time = dt * np.arange(n_samples)
    residuals = 0.02 * rng.standard_normal((n_samples, n))
    start = n_samples // 2 if fault else n_samples
    direction = gen.steady_directions[gen.faults[min(1, n - 1)]]
    residuals[start:] += 0.3 * direction / max(np.linalg.norm(direction), 1e-12)
    statistic = np.linalg.norm(residuals, axis=1) / 0.02
    groups = tuple((f,) for f in gen.faults)
    steady = gen.steady_directions
    whitening = np.eye(n) if gen.covariance is None else whitening_matrix(gen.covariance)
    scores = np.clip(0.5 + 0.1 * rng.standard_normal((n_samples, len(groups))), 0, 1)
    scores[start:, min(1, len(groups) - 1)] = 0.99
    decided = np.arange(n_samples) >= min(10, n_samples)
    candidates = tuple(
        Candidate(g, s, float(np.sqrt(1 - s**2)))
        for g, s in zip((groups[1:2] + groups[:1] + groups[2:]), (0.991, 0.78, 0.4, 0.3), strict=False)
    )
    alarms = (
        (Alarm(time[start], time[min(start + 2, n_samples - 1)], None, candidates, start + 2, n_samples),)
        if fault
        else ()
    )
    alarm = np.zeros(n_samples, dtype=bool)
    alarm[start + 2 :] = fault
    made = Diagnosis(
        time=time,
        residuals=residuals,
        statistic=statistic,
        alarm=alarm,
        decided=decided,
        missing=np.zeros(n_samples, dtype=bool),
        scores=scores,
        alarms=alarms,
        generator=gen,
        test=ThresholdFacts(5.0, np.zeros(n), np.full(n, 0.08), whitening),
        naming=NamingFacts(groups, _signatures(gen, whitening)),
        settings={"threshold": "5 (given)"},
        recording=RecordingFacts("tank08.csv"),
        isolation=direction_test(Directional(), gen.subspaces, steady, whitening),
    )
    return changed(made, **changes)


def changed(diagnosis: Diagnosis, **changes: Any) -> Diagnosis:
    """Return a diagnosis with other values of its fields, and of the fields of its parts."""
    for name in ("test", "naming", "parts", "recording"):
        part = getattr(diagnosis, name)
        own = {one.name for one in fields(part)} - {one.name for one in fields(diagnosis)}
        changes[name] = replace(part, **{key: changes.pop(key) for key in list(changes) if key in own})
    return replace(diagnosis, **changes)


def _signatures(gen: ResidualGenerator, whitening: np.ndarray) -> tuple[np.ndarray, ...]:
    """Every fault's own, also where a monitor would put several into one group."""
    steady = gen.steady_directions
    return tuple(direction_test(Directional(), {f: gen.subspaces[f]}, steady, whitening).bases[0] for f in gen.faults)
