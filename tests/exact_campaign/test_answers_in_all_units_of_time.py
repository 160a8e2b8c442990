"""Designs and analyses of continuous plants whose rates are written in other units, from 2^-20 to 2^20."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import pytest

import residua as rs
from exact_campaign.answers import plain, without_numbers
from exact_campaign.cases import plant_of, units
from exact_campaign.kinds import KINDS, case_of
from residua.errors import ResiduaError
from residua.plant import Plant
from residua.plant.comparable_units import unit_of_rates_of, with_rates_times

D = rs.design


def _directional(plant: Plant) -> Any:
    directions = {name: np.eye(2)[i].tolist() for i, name in enumerate(plant.faults[:2])}
    return D.directional_parity(plant, directions=directions)


def _poles(plant: Plant, t: float) -> list[float]:
    return [-t * (1.1 + 0.3 * i) for i in range(plant.n_states)]


#: By name; each takes a plant and the unit of its rates.
DESIGNS: Mapping[str, Callable[[Plant, float], Any]] = {
    "luenberger": lambda p, t: D.luenberger_observer(p),
    "luenberger, poles": lambda p, t: D.luenberger_observer(p, poles=_poles(p, t)),
    "unknown input": lambda p, t: D.unknown_input_observer(p),
    "unknown input, margin": lambda p, t: D.unknown_input_observer(p, margin=0.7 * t),
    "reduced order": lambda p, t: D.reduced_order_observer(p),
    "descriptor": lambda p, t: D.descriptor_observer(p),
    "perfect": lambda p, t: D.perfect_observer(p),
    "perfect, least order": lambda p, t: D.perfect_observer(p, least_order=True, bandwidth=9 * t),
    "inverse form": lambda p, t: D.inverse_form_observer(p).observer,
    "kalman": lambda p, t: D.kalman_filter(p.with_noise(process=t * t, measurement=1.0)),
    "detection filter": lambda p, t: D.detection_filter(p),
    "detection filter, margin": lambda p, t: D.detection_filter(p, margin=0.8 * t),
    "robust detection filter": lambda p, t: D.robust_detection_filter(p),
    "eigenstructure": lambda p, t: D.eigenstructure_assignment(p),
    "fault estimator": lambda p, t: D.fault_estimator(p, faults=p.faults[:1]),
    "fault estimator, bandwidth": lambda p, t: D.fault_estimator(p, faults=p.faults[:1], bandwidth=20 * t),
    "decoupled": lambda p, t: D.decoupled_residual(p, insensitive_to=p.faults[:1]),
    "parity": lambda p, t: D.parity_relations(p),
    "parity, other poles": lambda p, t: (lambda made: made.with_poles([-t] * max(made.relations.orders)))(
        D.parity_relations(p)
    ),
    "primary": lambda p, t: D.primary_residuals(p),
    "optimal": lambda p, t: D.optimal_parity(p, order=2),
    "directional": lambda p, t: _directional(p),
    "sensor bank": lambda p, t: D.sensor_fault_bank(p, allow_missing=True),
    "actuator bank": lambda p, t: D.actuator_fault_bank(p, allow_missing=True),
    "structured bank": lambda p, t: D.structured_bank(p, ["1" * len(p.faults)]),
    "structured parity": lambda p, t: D.structured_parity(p, ["1" * len(p.faults)]),
    "gain from elsewhere": lambda p, t: rs.residual_generator_from_observer(
        p, gain=D.luenberger_observer(p, margin=2 * t).K
    ),
}


def _existence(plant: Plant, t: float) -> Any:
    found = rs.analysis.unknown_input_observer_existence(plant)
    return found.exists, found.useful, found.reasons, plain(found.fixed_poles / t)


def _diagnosability(plant: Plant) -> Any:
    found = rs.diagnosability(plant)
    facts = found.detectable, found.strongly_detectable, found.isolable, found.strongly_isolable
    return *map(plain, facts), found.groups, found.reasons()


def _zeros(plant: Plant, B: Any, Dv: Any) -> Any:
    found = rs.linear.invariant_zeros(plant.A, B, plant.C, Dv, plant.E)
    return len(found.zeros), found.normal_rank


def _detectability(plant: Plant) -> Any:
    found = rs.linear.detectability(plant.A, plant.C) if plant.E is None else None
    return None if found is None else (bool(found), len(found.unobservable_modes))


ANALYSES: Mapping[str, Callable[[Plant, float], Any]] = {
    "existence": _existence,
    "diagnosability": lambda p, t: _diagnosability(p),
    "mutually isolable": lambda p, t: plain(rs.coding.mutually_isolable(p).matrix),
    "attainable": lambda p, t: rs.coding.attainable(p).digits,
    "attainable, constant": lambda p, t: rs.coding.attainable(p, constant=True).digits,
    "parity orders": lambda p, t: D.parity_orders(p),
    "zeros": lambda p, t: _zeros(p, p.B, p.D),
    "zeros of disturbances": lambda p, t: _zeros(p, p.Bd, p.Dd),
    "rank": lambda p, t: rs.linear.pencil_rank_at(p.A, p.Bd, p.C, p.Dd, p.E, 0.375 * t).rank,
    "detectability": lambda p, t: _detectability(p),
}


def answered(ask: Callable[[], Any]) -> Any:
    """Return what is answered, or the kind of the error and its text without numbers."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            return ask()
        except ResiduaError as error:
            return f"{type(error).__name__}: {without_numbers(str(error))}"


def designed(design: Callable[[Plant, float], Any], plant: Plant, t: float) -> Any:
    """Return all that a design says, its rates in ``t``; the floats of its filter too, if the plant has a rate."""
    made: Any = design(plant, t)
    for name in ("residual_generator", "generator"):
        part = getattr(made, name, made)
        made = part() if callable(part) else part
    said = [without_numbers(note) for note in made.evidence.notes]
    facts = [plain(made.structure), {name: basis.shape[1] for name, basis in made.subspaces.items()}, said]
    if not unit_of_rates_of(plant):
        return facts
    s, evidence = made.system, made.evidence
    numbers = s.A / t, s.B / t, s.C, s.D, evidence.poles / t, evidence.requested_poles / t, evidence.fixed_poles / t
    sizes = {name: value / t for name, value in evidence.conditions.items() if name.startswith("size of")}
    if made.relations is not None:  # the newest sample has coefficient one, whatever its derivatives are in
        numbers += tuple(row.q[-1] / np.prod(row.basis.sizes[: row.order]) for row in made.relations.rows)
    return [*facts, *map(plain, numbers), sizes, dict(evidence.decoupling)]


def differences(kind: str, seed: int, times: tuple[float, ...]) -> list[str]:
    """Return what is not as in the unit of time that a plant was made in."""
    case = case_of(kind, seed)
    base = plant_of(case)
    others = [(t, with_rates_times(base, t)) for t in times]
    others.append((times[0], with_rates_times(plant_of(case, units(case, seed, powers_of_two=True)), times[0])))
    out = []
    for name, ask in ANALYSES.items():
        wanted = answered(partial(ask, base, 1.0))
        out += [
            f"{name} x {t:g}" for t, plant in others if _masked(answered(partial(ask, plant, t))) != _masked(wanted)
        ]
    for name, design in DESIGNS.items():
        if name == "optimal" and not unit_of_rates_of(base):
            continue  # expected sizes of faults are compared with one another: they have units, and the rates then
        wanted = answered(partial(designed, design, base, 1.0))
        for t, plant in others[:-1]:
            if answered(partial(designed, design, plant, t)) != wanted:
                out.append(f"{name} x {t:g}")
    return out


def _masked(value: Any) -> str:
    return without_numbers(str(value))


def continuous(first: int, most: int) -> list[tuple[str, int]]:
    """Return a seed of each kind that makes a continuous plant, from some seed on."""
    found = ((kind, next((s for s in range(first, first + most) if not case_of(kind, s).dt), None)) for kind in KINDS)
    return [(kind, seed) for kind, seed in found if seed is not None]


@pytest.mark.parametrize(("kind", "seed"), continuous(703, 10))
def test_nothing_depends_on_the_unit_of_time(kind: str, seed: int) -> None:
    """To the last bit if the plant has a rate; if it has none, other units of its signals are all that changes."""
    assert differences(kind, seed, (2.0**-20,) if len(kind) % 2 else (2.0**20,)) == []


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        # block rows with powers of A, and chains of sections, stood beside others in the unit of the caller
        ("alike directions", 700),
        ("oscillators", 704),
        ("stiff", 705),
        ("integrators", 705),
        # so did derivatives beside measurements, of which a gain is made
        ("duplicated sensors", 702),
        # columns of faults beside a pencil at points of the size of its rates
        ("integrators", 704),
        ("integrators", 714),
    ],
)
def test_what_depended_on_the_unit_of_time(kind: str, seed: int) -> None:
    assert differences(kind, seed, (2.0**-20, 2.0**-4, 2.0**20)) == []


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(720, 740))
def test_nothing_depends_on_any_unit_of_time(seed: int) -> None:
    for kind, one in continuous(seed, 1):
        assert differences(kind, one, (2.0**-20, 2.0**-7, 2.0**20)) == [], kind
