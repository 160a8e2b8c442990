"""Designs for plants that are not known exactly: variants, parameters, sets with certified bounds."""

from __future__ import annotations

import numpy as np

import residua as rs
from residua.decide import NormThreshold
from residua.design import DifferentialEvolution, GeneticSearch
from robust_loops import random_loop
from same_results.designs import note_design
from same_results.ledger import Ledger
from same_results.monitors import Watch

D = rs.design
STEP = 0.02
NOMINAL = {"R": 1.0, "k": 0.5}


def motor(R: float, k: float) -> rs.Plant:
    """A direct-current motor: current and speed."""
    A = [[-2 * R, -2 * k], [10 * k, -0.5]]
    plant = rs.Plant(A, [[2], [0]], np.eye(2), inputs="voltage", outputs=["current", "speed"])
    return plant.with_sensor_faults().discretize(STEP)


def measure_uncertain(watch: Watch) -> None:
    """Measure them all."""
    _variants(watch)
    _parameters(watch)
    for seed, search in ((0, DifferentialEvolution(20, 6, polish=False)), (3, GeneticSearch(20, 6, polish=False))):
        _robust_bank(watch, seed, search)


def _variants(watch: Watch) -> None:
    """One relation for several models, and the best one for one."""
    plants = [motor(R, k) for R in (0.9, 1.0, 1.15) for k in (0.45, 0.5)]
    rng = np.random.default_rng(4)
    u = rng.standard_normal((500, 1))
    y = motor(1.1, 0.5).system(("control",)).simulate(u) + 0.01 * rng.standard_normal((500, 2))
    late = y + np.where(np.arange(500) >= 250, 0.5, 0.0)[:, None] * [1.0, 0.0]
    designs = {
        "multi_model_parity": lambda: D.multi_model_parity(plants, order=2, relations=2),
        "multi_model_parity, faults": lambda: D.multi_model_parity(plants, order=2, relations=2, criterion="faults"),
        "optimal_parity": lambda: D.optimal_parity(plants[0], order=3, variants=plants[1:]),
    }
    for name, make in designs.items():
        made = watch.ledger.attempt(name, make)
        if made is not None:
            note_design(watch.ledger, name, made)
            watch.ledger.note(name, "spread", D.model_spread(made.generator, plants))
            watch.monitor(name, rs.Monitor(made, test=NormThreshold(window=4)), (u, y), (u, late))


def _parameters(watch: Watch) -> None:
    """Residuals that parameters do not reach, and the equations that they reach least."""
    made = watch.ledger.attempt("insensitive_parity", lambda: D.insensitive_parity(motor, NOMINAL, insensitive_to="R"))
    if made is not None:
        watch.ledger.note("insensitive_parity", "facts", made.members, made.ignored, made.codes, made.shares)
        rng = np.random.default_rng(8)
        u = np.repeat(rng.standard_normal((40, 1)), 25, axis=0)
        y = motor(1.05, 0.5).system(("control",)).simulate(u) + 1e-3 * rng.standard_normal((1000, 2))
        fitted = watch.ledger.attempt("insensitive_parity/fit", lambda: made.fit(u, y, false_alarm_rate=0.01))
        if fitted is not None:
            watch.ledger.count("insensitive_parity/fit", "threshold", fitted.thresholds)
            watch.ledger.count("insensitive_parity/fit", "residuals", fitted.run(u, y).residuals)
    relations = D.parity_relations(motor(**NOMINAL))
    choice = watch.ledger.attempt(
        "select_equations", lambda: D.select_equations(relations, motor, NOMINAL, inputs=[1.0])
    )
    if choice is not None:
        watch.ledger.note("select_equations", "choice", choice.chosen, choice.measures, choice.costs)


def _robust_bank(watch: Watch, seed: int, search: DifferentialEvolution | GeneticSearch) -> None:
    """A bank with certified thresholds for a generated loop, run on a recording of a member."""
    loop, case = random_loop(seed, most_states=3), f"robust loop {seed}"
    bank = watch.ledger.attempt(case, lambda: D.robust_l1_bank(loop, search=search, sizes={}, progress=False))
    if bank is None:
        return
    note_design(watch.ledger, case, bank)
    for name, one in bank.estimators.items():
        watch.ledger.count(f"{case}/{name}", "bounds", [one.threshold, one.certificate.attained, one.sensitivity.bound])
        watch.ledger.note(f"{case}/{name}", "search", one.search.x, one.search.history, one.cost)
    plant, rng = loop.nominal, np.random.default_rng(seed)
    w = rng.standard_normal((400, len(plant.disturbances)))
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    f = np.zeros((400, len(plant.faults)))
    f[200:, 0] = 2.0
    y = plant.system(("disturbance", "fault")).simulate(np.hstack([w, f]))
    _bounds(watch.ledger, case, bank, loop)
    watch.monitor(case, rs.Monitor(bank), None, (None, y))


def _bounds(ledger: Ledger, case: str, bank: rs.design.RobustL1Bank, loop: rs.UncertainPlant) -> None:
    found = ledger.attempt(f"{case}/certified", lambda: D.certified_thresholds(bank, loop))
    if found is not None:
        ledger.count(f"{case}/certified", "thresholds", [float(one) for one in found.values()])
