"""Numbers in errors and notes are in the unit of time of the plant, however a design works inside."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from typing import Any, cast

import numpy as np
import pytest
from numpy.testing import assert_allclose

import residua as rs
from residua.errors import ResiduaError
from residua.plant import Plant
from scaled_plants import with_rates_times

D = rs.design
A = np.array([[-1, 0.5, 0], [0.3, -2, 0.4], [0, 0.2, -3]])
B = np.array([[1.0], [0], [0.5]])
TWO = np.eye(3)[:2]
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?:[+-]\d+(?:\.\d+)?(?:e[+-]?\d+)?j)?")


def _seen() -> Plant:
    return rs.Plant(A, B, TWO).with_actuator_faults().with_sensor_faults()


def _all_seen() -> Plant:
    return rs.Plant(A, B, np.eye(3)).with_actuator_faults().with_sensor_faults()


def _hidden(mode: float, *, sensors: bool = True) -> Plant:
    """Return a plant whose third state no measurement sees."""
    a = A.copy()
    a[:2, 2], a[2] = 0, [0, 0, mode]
    plant = rs.Plant(a, B, TWO).with_actuator_faults()
    return plant.with_sensor_faults() if sensors else plant


def _joint_zero() -> Plant:
    """Return a plant whose two faults have the invariant zero -1 together, and none alone."""
    a = np.array([[-1, 0.5, 2.0], [0.3, -2, 1.0], [1, 0.2, 1.5]])
    return rs.Plant(a, np.zeros((3, 1)), TWO).with_faults({"f": [1.0, 0, 1], "g": [0, 1.0, 0.5]})


def _own_zero() -> Plant:
    """Return a plant whose fault has the invariant zero -3, and that has no hidden mode."""
    a = np.array([[-1, 0.5, 2.0], [0.3, -2, 0], [1, 0.2, -1]])
    return rs.Plant(a, np.zeros((3, 1)), TWO).with_faults({"f": [1.0, 0, 1]})


def _singular() -> Plant:
    plant = rs.Plant([[1, 2], [3, 4.0]], [[1], [1.0]], [[1, 1.0]], E=[[1, 0], [0, 0.0]])
    return plant.with_actuator_faults().with_sensor_faults()


def _disturbed() -> Plant:
    return rs.Plant(A, B, TWO).with_disturbances({"d": [1, 0, 0]})


def _first(plant: Plant, **options: Any) -> Any:
    return D.fault_estimator(plant, faults=plant.faults[:1], **options)


#: By what is asked: a plant, a design of it with rates in a unit, what follows rates in the text and to which power.
TEXTS: dict[str, tuple[Callable[[], Plant], Callable[[Plant, float], Any], dict[str, float]]] = {
    "detection filter, hidden mode": (lambda: _hidden(1), lambda p, t: D.detection_filter(p), {"the mode": 1}),
    "eigenstructure, hidden mode": (lambda: _hidden(1), lambda p, t: D.eigenstructure_assignment(p), {"the mode": 1}),
    "luenberger, hidden mode": (lambda: _hidden(1), lambda p, t: D.luenberger_observer(p), {"mode": 1}),
    "hidden mode and margin": (
        lambda: _hidden(-3, sensors=False),
        lambda p, t: D.eigenstructure_assignment(p, margin=3.5 * t),
        {"the mode": 1, "margin": 1},
    ),
    "zero and margin": (
        _own_zero,
        lambda p, t: D.eigenstructure_assignment(p, insensitive_to="f", margin=3.5 * t, combine=False),
        {"zero": 1, "margin": 1},
    ),
    "one pole for all": (_all_seen, lambda p, t: D.detection_filter(p, poles=[3 * t] * 3), {"the pole": 1}),
    "number of poles": (_joint_zero, lambda p, t: D.detection_filter(p, poles=[-3 * t] * 7), {"fixed:": 1}),
    "a fixed pole": (_joint_zero, lambda p, t: D.detection_filter(p, poles=[-7 * t, -8 * t, -9 * t]), {"the pole": 1}),
    "no margin": (_seen, lambda p, t: D.detection_filter(p, margin=-t), {"got": 1}),
    "margins": (_seen, lambda p, t: D.luenberger_observer(p, margin=cast(Any, [t, 2 * t])), {"got": 1}),
    "bandwidth of estimates": (_seen, lambda p, t: _first(p, bandwidth=-t), {"got": 1}),
    "bandwidth of derivatives": (_singular, lambda p, t: D.perfect_observer(p, bandwidth=-t), {"got": 1}),
    "gain from elsewhere": (_singular, lambda p, t: D.perfect_observer(p, K=[[t], [2 * t]]), {"eigenvalue": -1}),
    "gain of poles": (
        _seen,
        lambda p, t: D.luenberger_observer(p, poles=[-1e9 * t, -1e9 * t * (1 + 1e-9), -1e-9 * t]),
        {"the poles": 1, "reached": 1, "norm of the gain": 1},
    ),
    "inverses of poles": (
        _disturbed,
        lambda p, t: D.inverse_form_observer(p, poles=[-1e-9 * t, -1e9 * t, -t]),
        {"the poles": 1},
    ),
}


def _error(plant: Plant, design: Callable[[Plant, float], Any], t: float) -> str:
    with pytest.raises(ResiduaError) as raised:
        design(with_rates_times(plant, t), t)
    return str(raised.value)


def _split(text: str, after: dict[str, float]) -> tuple[str, dict[str, list[complex]]]:
    """Return the text without what is expected to have another unit, and that by the words before it."""
    found = {}
    for words in after:
        said = re.search(rf"{words} (\[?{NUMBER.pattern}(?:, {NUMBER.pattern})*)", text)
        assert said, (words, text)
        found[words] = [complex(one) for one in NUMBER.findall(said[1])]
        text = text[: said.start(1)] + text[said.end(1) :]
    return text, found


@pytest.mark.parametrize("name", TEXTS)
def test_errors_say_rates_in_the_unit_of_the_plant(name: str) -> None:
    make, design, powers = TEXTS[name]
    rest, numbers = _split(_error(make(), design, 1.0), powers)
    for t in (2.0**10, 2.0**-20):
        then, scaled = _split(_error(make(), design, t), powers)
        assert then == rest
        for words, power in powers.items():
            assert_allclose(scaled[words], np.array(numbers[words]) * t**power, rtol=2e-2, err_msg=f"{words} x {t:g}")


def test_errors_say_the_modes_that_the_plant_has() -> None:
    assert "the mode 1024;" in _error(_hidden(1), lambda p, t: D.detection_filter(p), 2.0**10)
    assert "got -1000" in _error(_seen(), lambda p, t: D.detection_filter(p, margin=-1000), 1000.0)
    assert "the pole 3000 is" in _error(_all_seen(), lambda p, t: D.detection_filter(p, poles=[3000] * 3), 1000.0)


DESIGNS: dict[str, tuple[Callable[[], Plant], Callable[[Plant], Any]]] = {
    "luenberger": (_seen, D.luenberger_observer),
    "unknown input": (_disturbed, D.unknown_input_observer),
    "reduced order": (_seen, D.reduced_order_observer),
    "perfect": (_singular, D.perfect_observer),
    "perfect, least order": (_seen, partial(D.perfect_observer, least_order=True)),
    "fault estimator": (_seen, _first),
    "detection filter": (_joint_zero, D.detection_filter),
    "eigenstructure": (_seen, D.eigenstructure_assignment),
    "decoupled": (_seen, lambda p: D.decoupled_residual(p, insensitive_to=p.faults[:1])),
    "parity": (_seen, D.parity_relations),
}
#: How the numbers of evidence begin that have rates in them, and their power.
RATES = {"bandwidth": 1, "lag of": -1, "leaks measured from": 1}
#: Designs whose gain is not in balanced units, which have no rate.
OWN_GAINS = ("perfect", "perfect, least order", "parity")


@pytest.mark.parametrize("name", DESIGNS)
def test_numbers_of_evidence_have_the_unit_of_the_plant(name: str) -> None:
    """Those without a unit, and those of ranks, are the same in whatever unit of time."""
    make, design = DESIGNS[name]
    base = design(make()).evidence
    rates = RATES | ({"size of": 1, "norm of the gain": 1} if name in OWN_GAINS else {})
    for t in (2.0**10, 2.0**-20):
        other = design(with_rates_times(make(), t)).evidence
        assert {key: str(rank) for key, rank in other.ranks.items()} == {k: str(rank) for k, rank in base.ranks.items()}
        assert other.notes == base.notes
        powers = {key: next((p for start, p in rates.items() if key.startswith(start)), 0) for key in base.conditions}
        wanted = {key: value * t ** powers[key] for key, value in base.conditions.items()}
        assert dict(other.conditions) == pytest.approx(wanted, rel=1e-6, abs=1e-13)


def test_ranks_are_those_of_even_units_of_signals_too() -> None:
    x, plant = np.array([2.0**7, 1, 2.0**-5]), _seen()
    other = rs.Plant(A * x[:, None] / x, B * x[:, None] * 2.0**-3, TWO / x * 2.0**4)
    other = other.with_actuator_faults().with_sensor_faults()
    ranks = [{k: str(rank) for k, rank in _first(p).evidence.ranks.items()} for p in (plant, other)]
    assert ranks[0]
    assert ranks[0] == ranks[1]


@pytest.mark.parametrize("t", [1.0, 1000.0, 2.0**-20])
@pytest.mark.parametrize("name", ["perfect", "perfect, least order"])
def test_the_sum_of_coefficients_is_that_of_the_matrices_handed_out(name: str, t: float) -> None:
    make, design = DESIGNS[name]
    made = design(with_rates_times(make(), t))
    C, power, total = made.plant.C[made.rows], made.L, 0.0
    C = np.hstack([C, made.plant.Dd[made.rows]])
    for i in range(made.index):
        total += made.bandwidth**i * np.linalg.norm(C @ power, 2)
        power = made.N @ power
    assert_allclose(made.evidence.conditions["sum of |C (bandwidth N)^i L|"], total, rtol=1e-9)
