"""Answers that rounding once decided, in base units and in units from 2^-20 to 2^20, against exact ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from flint import fmpq

import residua as rs
from exact import questions
from exact.matrices import rank
from exact.plants import at, exact_plant
from exact.responses import frequencies, paths
from exact_campaign import designs
from exact_campaign.answers import Subject
from exact_campaign.cases import base_units, plant_of, units
from exact_campaign.kinds import case_of
from residua.design.core.decoupling import leak
from residua.errors import DesignError
from residua.plant import Plant

#: A gain of a plant of small fractions; one that rounding asks for is 1e10 and more.
GAIN = 1e5


def in_all_units(kind: str, seed: int) -> list[Plant]:
    """Return a plant of the campaign in base units and in four others."""
    case = case_of(kind, seed)
    return [plant_of(case), *(plant_of(case, units(case, k, powers_of_two=True)) for k in (seed, 0, 1, 2))]


def even_filter(plant: Plant) -> Any:
    """Return the detection filter by pseudoinverses in balanced units, which does not depend on those of the plant."""
    return rs.design.detection_filter(plant, scaling="even")


def reaction(call: Callable[[], Any]) -> str:
    """Return how a design ends, without numbers: what it makes, or which error it raises."""
    try:
        made = call()
    except DesignError as error:
        return type(error).__name__
    return repr(np.asarray(made.structure).tolist())


@pytest.mark.parametrize("seed", [55, 133])
def test_channels_of_a_nilpotent_plant_are_not_scaled_to_rounding(seed: int) -> None:
    """Its spectral radius is the n-th root of rounding, to which inputs and outputs were brought down."""
    plants = in_all_units("repeated poles", seed)
    X = exact_plant(plants[0])
    wanted = rank(at(X.pencil(X.Bd, X.Dd), fmpq(3, 8)))
    for p in plants:
        assert rs.linear.pencil_rank_at(p.A, p.Bd, p.C, p.Dd, s=0.375).rank == wanted


@pytest.mark.parametrize("unit_of_time", [2.0**-20, 1.0, 2.0**20])
def test_zeros_of_a_stiff_plant_do_not_depend_on_units_nor_on_that_of_time(unit_of_time: float) -> None:
    """Rates of 2^10 made a coupling of 2^-13 nothing beside the outputs, which had no share in the unit of ``s``."""
    for p in in_all_units("stiff", 47):
        none = p.B[:, :0]
        assert not rs.linear.invariant_zeros(p.A * unit_of_time, none, p.C).zeros.size
        seen = rs.linear.pencil_rank_at(p.A * unit_of_time, none, p.C, s=0.375 * unit_of_time)
        assert seen.rank == p.n_states


def test_a_state_that_nothing_sees_is_hidden_in_all_units() -> None:
    """What rounding left beside the state of its own was a direction where other states have larger units."""
    for p in in_all_units("stiff", 310):
        answer = rs.linear.detectability(p.A, p.C)
        assert len(answer.unobservable_modes) == 1
        assert rs.linear.observability_form(p.A, p.C).residual < 1e-9


@pytest.mark.parametrize(("kind", "seed"), [("repeated poles", 25), ("repeated poles", 108), ("repeated poles", 133)])
@pytest.mark.parametrize("design", [rs.design.detection_filter, rs.design.luenberger_observer])
def test_no_gain_is_rounding(kind: str, seed: int, design: Any) -> None:
    """Whatever decides on it, a gain of plants of small fractions in even units is no 1e10."""
    plant = plant_of(case_of(kind, seed))
    made = design(plant)
    assert max(v for name, v in made.evidence.conditions.items() if name.startswith(("norm of", "size of"))) < GAIN


@pytest.mark.parametrize(
    ("kind", "seed", "design"),
    [
        # the ideal gain (A - p I) C^+ kept what rounding left of a pseudo-inverse
        ("more outputs than states", 122, even_filter),
        ("hidden modes", 28, even_filter),
        # a control that is decoupled entered by what rounding left of T B, and all of K where T = 0
        ("more outputs than states", 111, lambda plant: rs.design.actuator_fault_bank(plant, observer="unknown-input")),
        ("singular E", 102, lambda plant: rs.design.actuator_fault_bank(plant, observer="unknown-input")),
        # the disturbance in an output came in through what rounding left of a pseudo-inverse
        ("more outputs than states", 207, lambda plant: rs.design.reduced_order_observer(plant).residual_generator()),
        # a response that is nothing was held against its rounding
        ("delays", 115, lambda plant: rs.design.perfect_observer(plant, least_order=True).residual_generator()),
        (
            "alike directions",
            139,
            lambda plant: rs.design.perfect_observer(plant, least_order=True).residual_generator(),
        ),
        # the error of an output that is always nothing was all that was read of it
        ("companion", 2, lambda plant: rs.design.perfect_observer(plant).residual_generator()),
        ("alike directions", 2, lambda plant: rs.design.perfect_observer(plant).residual_generator()),
    ],
)
def test_structure_does_not_depend_on_units(kind: str, seed: int, design: Any) -> None:
    reactions = {reaction(lambda p=p: design(p)) for p in in_all_units(kind, seed)}
    assert len(reactions) == 1
    assert "Error" not in reactions.pop()


def test_an_observer_delivers_no_rows_of_pure_rounding() -> None:
    """A measurement that the estimate reproduces is a filtered copy of other residuals, or else nothing at all."""
    for p in in_all_units("duplicated sensors", 121):
        made = rs.design.actuator_fault_bank(p, observer="unknown-input", allow_missing=True).generator
        assert made.n_residuals == 2
        assert made.structure.any(axis=1).all()


def test_an_equation_that_outputs_free_of_disturbances_is_a_residual() -> None:
    """An algebraic equation holds the disturbance that an output measures: their combination is undisturbed."""
    for p in in_all_units("singular E", 37):
        assert questions.residual_exists(exact_plant(p))
        made = rs.design.unknown_input_observer(p).residual_generator()
        assert made.n_residuals == 1
        assert made.structure.all()
        assert made.evidence.decoupling["disturbance"] < 1e-9


def test_no_response_is_where_no_coupling_leads() -> None:
    """Pivoting mixes rows of states that nothing couples, and left 1e-16 of the largest response in the others."""
    plant = plant_of(case_of("stiff", 122))
    bank = rs.design.actuator_fault_bank(plant, observer="unknown-input")
    assert bank.generator.structure.tolist() == [[False, False, False, x] for x in (False, False, True, True)]
    s = rs.linear.StateSpace([[-1.0, 0.0], [-3.0, -2.0]], [[0.0], [1.0]], [[1.0, 0.0]])
    assert not np.any(s.frequency_response(np.array([0.1, 1.0])))


def test_directions_are_told_in_units_of_what_residuals_read() -> None:
    """An ill-conditioned observer has terms of 1e9 inside, beside which a direction of size one was rounding."""
    for by in (None, units(case_of("stiff", 12), 0, powers_of_two=True)):
        plant = plant_of(case_of("stiff", 12), by)
        made = rs.design.sensor_fault_bank(plant, observer="unknown-input", allow_missing=True).generator
        y = np.ones(plant.n_outputs) if by is None else by.y
        responses = paths(made.system, made.plant, y, frequencies(plant.dt))
        size = responses.reach[:, :, responses.to_faults].max(axis=(0, 2))
        for j, name in enumerate(plant.faults):
            basis = np.linalg.qr(made.subspaces[name] / size[:, None])[0]
            r = (responses.total[:, :, responses.to_faults][:, :, j] / size).T
            off = np.linalg.norm(r - basis @ (basis.T @ r), axis=0)
            assert np.all(off < 1e-6 * np.linalg.norm(r, axis=0)), name


def directional(plant: Plant) -> Any:
    """Return relations that give the first two faults residuals of their own."""
    directions = {plant.faults[0]: [1.0, 0.0], plant.faults[1]: [0.0, 1.0]}
    return rs.design.directional_parity(plant, directions=directions, insensitive_to=plant.faults[2:3])


def leaks_in_units(kind: str, seed: int, design: Callable[[Plant], Any]) -> list[float]:
    """Return by how much controls leak into a residual, in base units and in others."""
    case = case_of(kind, seed)
    plants = [plant_of(case), plant_of(case, units(case, seed, powers_of_two=True))]
    return [float(design(plant).evidence.decoupling["control"]) for plant in plants]


@pytest.mark.parametrize(("kind", "seed"), [("integrators", 133), ("sparse", 202)])
def test_relations_of_chains_of_integrators_do_not_depend_on_units(kind: str, seed: int) -> None:
    """Such a chain has no rate but by the units of its states, which were those of the caller."""
    leaks = leaks_in_units(kind, seed, directional)
    assert max(leaks) < max(10 * min(leaks), 1e-11)


def test_parts_that_nothing_connects_are_not_combined_in_units_of_the_caller() -> None:
    reactions = {reaction(lambda p=p: directional(p)) for p in in_all_units("no states", 123)}
    assert len(reactions) == 1
    assert "Error" not in reactions.pop()


def test_relations_are_the_same_to_the_last_bit_whatever_the_units_of_what_they_ignore() -> None:
    """Columns of ignored disturbances kept the units of the caller, and moved the rounding of the others."""
    base, other = leaks_in_units("integrators", 130, rs.design.parity_relations)
    assert base == other


def test_relations_of_a_structure_do_not_exist_by_units() -> None:
    plants = in_all_units("oscillators", 204)
    assert len({reaction(lambda p=p: rs.design.structured_parity(p, ["11111"]).generator) for p in plants}) == 1


def test_a_control_that_enters_nothing_is_not_read() -> None:
    """A column of rounding leaked by all that there is of it, while the evidence said 5.6e-16."""
    for p in in_all_units("singular E", 319):
        made = rs.design.descriptor_observer(p).residual_generator()
        assert not np.any(made.system.D[:, 1])
        assert np.all(made.system.D[:, 0] != 0)


def test_outputs_that_only_a_disturbance_connects_have_a_common_unit() -> None:
    """Beside an output in another unit a fault of the size of one was taken for rounding, and was not marked."""
    case = case_of("no states", 324)
    for by in (None, units(case, 324, powers_of_two=False), units(case, 324, powers_of_two=True)):
        made = rs.design.reduced_order_observer(plant_of(case, by)).residual_generator()
        assert sorted(made.structure.tolist()) == [[False, True, False, False], [True] * 4, [True] * 4]


@pytest.mark.parametrize(("kind", "seed", "faults"), [("no states", 315, 3), ("no states", 318, 1)])
def test_the_reading_of_a_fault_reads_no_output_by_rounding(kind: str, seed: int, faults: int) -> None:
    for p in in_all_units(kind, seed):
        made = rs.design.fault_estimator(p, faults=p.faults[:faults]).generator
        wanted = np.eye(faults, len(p.faults), dtype=bool)
        assert np.array_equal(made.structure, wanted)
        form = made.internal_form()
        assert np.array_equal(form.D[:, : len(p.faults)] != 0, wanted)


@pytest.mark.parametrize(("kind", "seed"), [("sparse", 402), ("more outputs than states", 419)])
def test_perfect_observers_are_designed_in_units_that_do_not_run_away(kind: str, seed: int) -> None:
    """Sweeps that even out norms went on to 2^20 where parts of a plant lead one way only: N had entries of 1e-8."""
    for p in in_all_units(kind, seed):
        assert rs.design.perfect_observer(p, least_order=True).evidence.conditions["estimate off the state"] < 1e-7


@pytest.mark.parametrize(("kind", "seed"), [("alike directions", 139), ("singular E", 313)])
def test_a_state_that_nothing_moves_is_estimated_all_the_same(kind: str, seed: int) -> None:
    """Rounding was all that there was of it, and the estimate was off by one of that."""
    for p in in_all_units(kind, seed):
        assert rs.design.perfect_observer(p, least_order=True).evidence.conditions["estimate off the state"] < 1e-9


def test_the_inverse_form_has_no_pole_at_zero() -> None:
    """The unknown input observer has one there by default, whose inverse was that of rounding."""
    for p in in_all_units("feedthrough", 131):
        made = rs.design.inverse_form_observer(p)
        assert np.abs(made.poles).min() > 5e-3
        assert np.allclose(np.linalg.inv(made.N_BF), made.observer.F)
        assert np.allclose(made.N_BF, made.N_BO - made.K @ p.C)


def test_a_perfect_observer_reads_no_dead_sensor() -> None:
    for p in in_all_units("dead sensors", 419):
        dead = ~np.any(p.C, axis=1)
        assert dead.any()
        assert not np.any(rs.design.perfect_observer(p).L[:, dead])


def test_a_relation_reads_no_output_by_rounding() -> None:
    """Of relations that are combined 5e-13 was left of an output that cancels, and its fault was marked."""
    case = case_of("more outputs than states", 8)
    for by in (base_units(case), units(case, 8, powers_of_two=True)):
        subject = Subject(case, by)
        made = rs.design.optimal_parity(subject.plant, order=1, sizes=designs._sizes(subject)).generator
        read = np.abs(made.system.frequency_response([0.3, 2.0])).max(axis=(0, 1))[len(subject.plant.inputs) :] / by.y
        assert np.all((read == 0) | (read > 1e-6 * read.max()))
        assert np.any(read == 0)


@pytest.mark.parametrize(
    ("kind", "seed", "design"),
    [("delays", 504, rs.design.luenberger_observer), ("repeated poles", 503, rs.design.reduced_order_observer)],
)
def test_a_state_that_no_control_moves_is_no_reason_to_refuse(kind: str, seed: int, design: Any) -> None:
    """Rounding was all that there was of its estimate, which was off by that."""
    for p in in_all_units(kind, seed):
        assert design(p).evidence.conditions["estimate off the state"] < 1e-7


def test_a_residual_of_nothing_is_refused_by_its_reason() -> None:
    """What rounding left of it missed the identities by all that there was."""
    for p in in_all_units("singular E", 415):
        with pytest.raises(DesignError, match="zero whatever fails"):
            rs.design.descriptor_observer(p).residual_generator()


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        # events of a plain filter were those of a plant whose disturbances had been removed from its outputs
        ("dense", 415),
        # what of a sensor fault no state explains passed the gain, which weighs outputs otherwise
        ("hidden modes", 401),
        ("alike directions", 411),
        ("companion", 428),
    ],
)
def test_directions_are_kept_whatever_else_enters_the_outputs(kind: str, seed: int) -> None:
    """The filters were refused, because faults left the directions that events of another plant promised."""
    structures = [even_filter(p).structure.tolist() for p in in_all_units(kind, seed)]
    assert all(structure == structures[0] for structure in structures)
    plant = plant_of(case_of(kind, seed))
    made = even_filter(plant)
    for j, name in enumerate(plant.faults):
        response = made.internal_form().frequency_response(frequencies(plant.dt))[:, :, j]
        basis = made.subspaces[name]
        off = response.T - basis @ (basis.T @ response.T)
        assert np.abs(off).max() <= 1e-6 * max(np.abs(response).max(), 1e-9)


def test_a_zero_at_the_boundary_is_not_stable_by_rounding() -> None:
    """It came out as -7e-20, for a small entry of a pseudo-inverse had the rounding of large ones."""
    for p in in_all_units("stiff", 603):
        answer = rs.analysis.unknown_input_observer_existence(p)
        assert not answer
        assert abs(answer.fixed_poles) < 1e-9 * p.balanced.units.rate
        with pytest.raises(DesignError, match=r"invariant zero (0|-?[0-9.]+e-)"):
            rs.design.unknown_input_observer(p)


@pytest.mark.parametrize("zeros", [0, 1])
def test_how_far_identities_are_missed_does_not_depend_on_the_unit_of_time(zeros: int) -> None:
    """A row of the state map that is zero had the size of terms with a rate in them, in the unit of the caller."""
    A, T, off = np.diag([-1.0, -3.0]), np.vstack([np.eye(2), np.zeros((zeros, 2))]), 1e-9
    K = np.vstack([np.diag([2.0, 5.0]), np.zeros((zeros, 2))])
    F = np.pad(A - K[:2], ((0, zeros), (0, zeros))) - np.diag([0.0] * 2 + [4.0] * zeros)
    found = []
    for c in (2.0**-20, 1.0, 2.0**20):
        plant = rs.Plant(c * A, np.full((2, 1), c), np.eye(2)).with_faults({"f": [c, c]})
        B, D = np.hstack([T.sum(axis=1, keepdims=True), K + off]), np.eye(2, 3, 1)
        found.append(leak(rs.StateSpace(c * F, c * B, -T.T, D), plant, T).defects)
    assert found == pytest.approx([found[1]] * 3, rel=1e-6)
    assert found[1] > off / 100
