"""What can be designed for a plant, by name; and what there is to hash of a design."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import residua as rs
from same_results.ledger import Ledger

D = rs.design
#: Every plant has every so many of the designs made.
EVERY = 7


def _directions(p: rs.Plant) -> dict[str, list[float]]:
    """Return a direction for each of the first two faults."""
    return dict(zip(p.faults[:2], ([1.0, 0.0], [0.5, 1.0]), strict=False))


def _codes(p: rs.Plant) -> list[str]:
    """Return rows of which each ignores one of the first three faults."""
    n = len(p.faults)
    return ["".join("0" if i == j else "1" for i in range(n)) for j in range(min(n, 3))]


def _first(p: rs.Plant) -> list[str]:
    return list(p.faults[:1])


def _state_faults(p: rs.Plant) -> rs.Plant:
    """Return the plant with those faults alone that enter the states, one fewer than outputs."""
    kept = [name for j, name in enumerate(p.faults) if not p.Df[:, j].any()][: max(1, p.n_outputs - 1)]
    return p.without_disturbances().without_faults([name for name in p.faults if name not in kept])


DESIGNS: dict[str, Callable[[rs.Plant], Any]] = {
    "kalman_filter": lambda p: D.kalman_filter(p),
    "detection_filter": lambda p: D.detection_filter(p, faults=p.faults[:2]),
    "robust_detection_filter": lambda p: D.robust_detection_filter(p, faults=p.faults[:1]),
    "eigenstructure_assignment, right": lambda p: D.eigenstructure_assignment(p),
    "eigenstructure_assignment, left": lambda p: D.eigenstructure_assignment(
        p, side="left", insensitive_to=_first(p), approximate=True
    ),
    "unknown_input_observer": lambda p: D.unknown_input_observer(p).residual_generator(),
    "luenberger_observer": lambda p: D.luenberger_observer(p).residual_generator(),
    "reduced_order_observer": lambda p: D.reduced_order_observer(p).residual_generator(),
    "descriptor_observer": lambda p: D.descriptor_observer(p).residual_generator(),
    "perfect_observer": lambda p: D.perfect_observer(p).residual_generator(),
    "inverse_form_observer": lambda p: D.inverse_form_observer(_state_faults(p)).observer.residual_generator(),
    "fault_estimator": lambda p: D.fault_estimator(p, faults=_first(p)),
    "sensor_fault_estimators": lambda p: D.sensor_fault_estimators(p),
    "decoupled_residual": lambda p: D.decoupled_residual(p, insensitive_to=_first(p)),
    "parity_relations": lambda p: D.parity_relations(p),
    "parity_relations, insensitive": lambda p: D.parity_relations(p, insensitive_to=_first(p)),
    "primary_residuals": lambda p: D.primary_residuals(p),
    "structured_parity": lambda p: D.structured_parity(p, _codes(p), allow_missing=True),
    "directional_parity": lambda p: D.directional_parity(p, directions=_directions(p)),
    "optimal_parity": lambda p: D.optimal_parity(p, order=2),
    "structured_bank": lambda p: D.structured_bank(p, _codes(p), allow_missing=True),
    "sensor_fault_bank": lambda p: D.sensor_fault_bank(p, allow_missing=True),
    "sensor_fault_bank, dedicated": lambda p: D.sensor_fault_bank(p, scheme="dedicated", allow_missing=True),
    "sensor_fault_bank, minimal": lambda p: D.sensor_fault_bank(p, observer="minimal", allow_missing=True),
    "sensor_fault_bank, reduced": lambda p: D.sensor_fault_bank(p, observer="reduced-order", allow_missing=True),
    "actuator_fault_bank": lambda p: D.actuator_fault_bank(p, allow_missing=True),
    "actuator_fault_bank, dedicated": lambda p: D.actuator_fault_bank(p, scheme="dedicated", allow_missing=True),
    "matched_filters": lambda p: D.matched_filters(p, window=12),
    "matched_filters, steady": lambda p: D.matched_filters(p, window=12, steady=True),
    "residual_generator_from_observer": lambda p: D.residual_generator_from_observer(D.luenberger_observer(p)),
}

ANALYSES: dict[str, Callable[[rs.Plant], Any]] = {
    "diagnosability": lambda p: rs.diagnosability(p),
    "mutually isolable": lambda p: rs.coding.mutually_isolable(p).matrix,
    "attainable": lambda p: rs.coding.attainable(p, most=200).attainable,
    "coding set": lambda p: rs.coding.choose(p, quality="weak", most=200).structure,
    "existence": lambda p: rs.analysis.unknown_input_observer_existence(p).exists,
    "orders": lambda p: D.parity_orders(p, most_outputs=1),
    "suggestion": lambda p: rs.suggest(p),
    "compensation": lambda p: D.compensation_gain(p, _first(p)).gain,
}


def chosen(number: int) -> Iterator[tuple[str, Callable[[rs.Plant], Any]]]:
    """Yield the designs of a plant: by turns, so that every kind of plant has all of them."""
    for turn, (name, make) in enumerate(DESIGNS.items()):
        if (turn + number // 5) % EVERY == 0:
            yield name, make


def generators_of(made: Any) -> dict[str, Any]:
    """Return what a monitor can run of a design: itself, or its members by name."""
    if isinstance(made, D.SensorFaultEstimators):
        return dict(made.members)
    return {"": made}


def note_design(ledger: Ledger, case: str, made: Any) -> None:
    """Keep the matrices, names, structure and evidence of a generator, or of the one of a bank."""
    generator = getattr(made, "generator", made)
    system = generator.system
    ledger.note(case, "design", system.A, system.B, system.C, system.D, system.dt)
    ledger.note(case, "names", generator.residuals, generator.faults, generator.method)
    ledger.note(case, "evidence", generator.evidence)
    codes = np.zeros(0) if generator.codes is None else generator.codes
    ledger.note(case, "structure", generator.structure, codes, sorted(generator.estimated))
    ledger.note(case, "directions", *(x for name in generator.faults for x in (name, generator.subspaces[name])))


def note_analyses(ledger: Ledger, case: str, plant: rs.Plant, number: int) -> None:
    """Keep what is said of a plant before any design: by turns two questions, seldom the one that tries designs."""
    for turn, (name, ask) in enumerate(ANALYSES.items()):
        if (turn + number) % 4 or (name == "suggestion" and number % 25 > 0):
            continue
        answer = ledger.attempt(f"{case}/{name}", lambda ask=ask: ask(plant))
        if answer is not None:
            ledger.note(f"{case}/{name}", "answer", answer)
