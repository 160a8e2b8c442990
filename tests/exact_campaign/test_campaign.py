"""The campaign itself: its plants, what it notices, how it resumes; and a sample of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import residua as rs
from exact import pencils, questions, responses
from exact.plants import exact_plant
from exact_campaign import examination, runs
from exact_campaign.analyses import analyses
from exact_campaign.answers import FAILURES, Record, Subject, answered, without_numbers
from exact_campaign.cases import Case, base_units, in_other_time, literal, plant_of, scales_of, units
from exact_campaign.generators import examine_generator
from exact_campaign.kinds import KINDS, case_of
from exact_campaign.results import counted, smallest_failures
from exact_campaign.runs import chunks, done, run


def test_there_are_eighteen_kinds_and_a_seed_makes_the_same_plant() -> None:
    assert len(KINDS) == 18
    for kind in KINDS:
        assert case_of(kind, 3) == case_of(kind, 3)
        assert case_of(kind, 3) != case_of(kind, 4)


@pytest.mark.parametrize("kind", KINDS)
def test_powers_of_two_change_no_exact_answer(kind: str) -> None:
    for seed in range(4):
        case = case_of(kind, seed)
        one, other = (exact_plant(plant_of(case, by)) for by in (None, units(case, seed, powers_of_two=True)))
        for a, b in zip(one.pencil(one.Bd, one.Dd), other.pencil(other.Bd, other.Dd), strict=True):
            assert (a.nrows(), a.ncols()) == (b.nrows(), b.ncols())
        assert questions.fixed_polynomial(one) == questions.fixed_polynomial(other)
        assert questions.residual_indices(one) == questions.residual_indices(other)
        assert questions.isolable(one) == questions.isolable(other)
        assert questions.lasting_isolable(one) == questions.lasting_isolable(other)
        assert questions.unknown_input_observer(one) == questions.unknown_input_observer(other)


@pytest.mark.parametrize("kind", KINDS)
def test_the_text_of_a_plant_makes_it_again_to_the_bit(kind: str) -> None:
    case = case_of(kind, 5)
    for by in (None, units(case, 5, powers_of_two=True), units(case, 5, powers_of_two=False)):
        plant = plant_of(case, by)
        again = eval(literal(plant), {"rs": rs, "np": np})
        for name in ("A", "B", "C", "D", "Bd", "Dd"):
            assert np.array_equal(getattr(plant, name), getattr(again, name))
        columns = [again.faults.index(fault) for fault in plant.faults]
        assert np.array_equal(again.Bf[:, columns], plant.Bf)
        assert np.array_equal(again.Df[:, columns], plant.Df)


# ------------------------------------------------------------------- what it notices


def subject() -> Subject:
    case = Case("hand", 0, *(_fractions(M) for M in _MATRICES), sensors=(0,))
    return Subject(case, base_units(case))


_MATRICES = (
    [[-1, 1, 0], [0, -2, 1], [1, 0, -3]],
    [[1], [0], [1]],
    [[1, 0, 0], [0, 1, 0], [0, 1, 1]],
    [[0], [0], [0]],
    [[0], [0], [1]],
    [[0], [0], [0]],
    [[1, 0], [0, 1], [1, 0]],
    [[0, 0], [0, 0], [0, 0]],
)


def _fractions(M: list[list[int]]) -> list:
    from fractions import Fraction

    return [[Fraction(x) for x in row] for row in M]


def problems(made: rs.design.ResidualGenerator) -> set[str]:
    one = subject()
    record = Record("tried", answered(lambda: made))
    examine_generator(one, record, made, one.plant)
    return {topic for _, topic, _ in record.problems}


def test_a_sound_generator_has_no_problem() -> None:
    assert problems(rs.design.decoupled_residual(subject().plant)) == set()


def test_responses_are_known_whatever_the_sizes_of_states() -> None:
    """A state that rounding alone moves is 2^94 times as large as others in units in which all are moved alike."""
    B, C = np.zeros((20, 4)), np.kron(np.eye(4), np.eye(5)[-1:])
    weights = np.array([[-24.0, 32.0, -1e-29, 16.0, last] for last in (192.0, 5e-29, 5e-29, 5e-29)])
    for i, row in enumerate(weights):
        B[5 * i : 5 * i + 5, i] = row
    made = rs.StateSpace(np.kron(np.eye(4), np.diag(np.full(4, 0.25), -1)), B, C, np.eye(4), dt=1.0)
    plant = rs.Plant(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((4, 0)), dt=1.0).with_sensor_faults()
    w = responses.frequencies(1.0)
    found = responses.paths(made, plant, np.ones(4), w)
    z = np.exp(1j * np.array(w))
    truth = np.array([1 + sum(b * 0.25 ** (4 - j) * z ** (j - 5.0) for j, b in enumerate(row)) for row in weights])
    np.testing.assert_allclose(np.einsum("wii->wi", found.total), truth.T, rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_responses_of_a_filter_in_base_units_are_those_in_powers_of_two(kind: str) -> None:
    """To the last bit, and evaluated once for the plant in base units and in others."""
    case = case_of(kind, 5)
    evaluated = responses._paths.cache_info
    for by in (base_units(case), in_other_time(case, units(case, 5, powers_of_two=True), 5)):
        plant = plant_of(case, by)
        made = rs.design.primary_residuals(plant)
        asked = made.system, made.plant, by.y, [x * by.t for x in responses.frequencies(plant.dt)]
        plain, before = responses.paths(*asked), evaluated()
        scaled = responses.paths(*asked, scales_of(made.plant, by))
        assert by.name == "base" or evaluated().misses <= before.misses + 1
        assert plain.reach.any()
        for name, value in vars(plain).items():
            assert np.array_equal(value, getattr(scaled, name)), name


def test_a_leak_of_a_millionth_is_noticed() -> None:
    made = rs.design.decoupled_residual(subject().plant)
    D = made.system.D.copy()
    D[0, 0] += 3e-6 * np.abs(made.system.D).max()
    assert "leak" in problems(replace(made, system=made.system.replaced(D=D)))


def test_a_wrong_structure_is_noticed_both_ways() -> None:
    plant = subject().plant
    blind = rs.design.decoupled_residual(plant, insensitive_to="f1")
    one = plant.faults.index("f1")
    assert not blind.structure[:, one].any()
    said = dict(blind.subspaces)
    said["f1"] = np.ones((blind.n_residuals, 1)) / np.sqrt(blind.n_residuals)
    assert "structure" in problems(replace(blind, subspaces=said))
    said = dict(blind.subspaces)
    said["f2"] = np.zeros((blind.n_residuals, 0))
    assert "structure" in problems(replace(blind, subspaces=said))


def test_a_direction_that_is_left_is_noticed() -> None:
    made = rs.design.decoupled_residual(subject().plant)
    k = made.n_residuals
    assert k > 1
    said = {name: np.eye(k)[:, :1] if basis.shape[1] else basis for name, basis in made.subspaces.items()}
    assert "subspace" in problems(replace(made, subspaces=said))


def test_wrong_zeros_and_a_wrong_existence_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    right = rs.linear.invariant_zeros
    monkeypatch.setattr(
        rs.linear, "invariant_zeros", lambda *M: replace(right(*M), zeros=np.append(right(*M).zeros, -5.0))
    )
    existence = rs.analysis.unknown_input_observer_existence
    monkeypatch.setattr(
        rs.analysis,
        "unknown_input_observer_existence",
        lambda plant: replace(existence(plant), exists=False, reasons=("no",)),
    )
    one = subject()
    analyses(one)
    outcomes = {name: record.outcome for name, record in one.records.items()}
    assert outcomes["invariant_zeros (u)"] == "wrong"
    assert outcomes["unknown_input_observer_existence"] == "wrong"


def test_what_depends_on_units_is_noticed_and_numbers_in_reasons_are_not() -> None:
    base, other = subject(), subject()
    for one, count, why in ((base, 1, "rank 1 < 2: no"), (other, 2, "rank 1 < 2.5e-3: no")):
        one.ask("a", lambda: 1).facts = {"count": count}
        one.ask("b", lambda why=why: _refuse(why))
    examination.compare(base, other)
    assert [topic for _, topic, _ in other.records["a"].problems] == ["units: count"]
    assert other.records["b"].problems == []
    assert without_numbers("y1 of x2: -1.5e-3+2i < 4") == "y1 of x2: # < #"


def _refuse(why: str) -> None:
    raise rs.errors.DesignError(why)


def test_an_error_outside_the_package_is_a_crash() -> None:
    assert "ZeroDivisionError" in subject().ask("c", lambda: 1 // 0).answer.crash


# ------------------------------------------------------------------- how it runs


def test_a_campaign_is_resumed_where_it_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    failure = examination.Failure("dense", 0, "base", "f", "wrong", "zeros", "text", "rs.Plant()")
    monkeypatch.setattr(runs, "examine", lambda kind, seed: ({"f | base": "wrong"}, [failure]))
    monkeypatch.setattr(runs, "ProcessPoolExecutor", _Here)
    record = tmp_path / "record.jsonl"
    run(36, 0, 1, record)
    whole = counted(record)
    assert sum(whole["plants"].values()) == 36
    lines = record.read_text().splitlines(keepends=True)
    record.write_text("".join(lines[:5]) + lines[5][:40])  # killed while it wrote
    assert len(done(record)) == 5
    run(36, 0, 1, record)
    assert counted(record) == whole
    (failed,) = smallest_failures(record)
    assert failed["count"] == 36
    assert json.loads(json.dumps(failed)) == failed


class _Here:
    """Runs at once what it is given."""

    def __init__(self, workers: int) -> None: ...

    def __enter__(self) -> _Here:
        return self

    def __exit__(self, *_: object) -> None: ...

    def submit(self, call, *arguments: object):
        from concurrent.futures import Future

        out: Future = Future()
        out.set_result(call(*arguments))
        return out


def test_the_plants_of_a_campaign_are_those_of_all_kinds() -> None:
    parts = chunks(100, 7)
    assert {part.kind for part in parts} == set(KINDS)
    assert sum(part.count for part in parts) == 108  # six of each
    assert all(part.first >= 7 for part in parts)


# ------------------------------------------------------------------- a sample


def failures(kind: str, seeds: range, stages: tuple | None) -> list[str]:
    found = [one for seed in seeds for one in examination.examine(kind, seed, stages)[1]]
    return [f"{one.units}: {one.function}: {one.text}\n{one.plant}" for one in found if one.outcome in FAILURES]


@pytest.mark.parametrize("kind", KINDS)
def test_analyses_of_a_sample_agree_with_exact_answers_in_all_units(kind: str) -> None:
    assert failures(kind, range(2), (analyses,)) == []


@pytest.mark.campaign
@pytest.mark.parametrize("kind", KINDS)
def test_everything_on_a_sample_agrees_with_exact_answers_in_all_units(kind: str) -> None:
    assert failures(kind, range(10), None) == []


def test_zeros_of_the_sample_are_those_of_the_pencil() -> None:
    plant = exact_plant(plant_of(case_of("planted zeros", 1)))
    P = plant.pencil(plant.Bd, plant.Dd)
    assert pencils.zero_polynomial(P) == pencils.zero_polynomial_by_reduction(P, plant.n)
