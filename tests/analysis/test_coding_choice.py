"""The choice of a coding set: against all subsets of the attainable rows."""

from __future__ import annotations

import time
from itertools import combinations

import numpy as np
import pytest

import residua as rs
from generated import nth, random_plant
from refusals import Refused
from residua.analysis.coding import CodingSet, attainable, choose, isolation_quality
from residua.decide import Structured
from residua.decide.structured import codes_of
from residua.errors import DesignError, SettingError

RANK = {"none": 0, "weak": 1, "strong": 2}


def aims(rows: np.ndarray) -> tuple[int, int]:
    """Return unevenness and the smallest distance between codes, the long way."""
    ones, zeros = rows.sum(axis=0), (~rows).sum(axis=1)
    distances = [int((rows[:, j] != rows[:, k]).sum()) for j, k in combinations(range(rows.shape[1]), 2)]
    return int(ones.max() - ones.min() + zeros.max() - zeros.min()), min(distances, default=len(rows))


def best(rows: np.ndarray, quality: str) -> tuple[int, int, int] | None:
    """Return the fewest rows, the least unevenness, and the largest distance, over all subsets."""
    for count in range(1, len(rows) + 1):
        found = []
        for chosen in combinations(range(len(rows)), count):
            S = rows[list(chosen)]
            if RANK[isolation_quality(S)] >= RANK[quality]:
                uneven, far = aims(S)
                found.append((uneven, -far))
        if found:
            uneven, far = min(found)
            return count, uneven, -far
    return None


def small(seed: int) -> rs.Plant | None:
    """Return a plant of up to 14 attainable rows, whose faults can all be told apart."""
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(2, 6)), int(rng.integers(2, 5))
    plant = random_plant(rng, n=n, outputs=p, inputs=2, faults=int(rng.integers(2, 5)), dt=0.1)
    sparse = rng.random((n, len(plant.faults))) < 0.5
    if not (sparse & (np.array(plant.Bf) != 0)).any(axis=0).all():
        return None
    plant = plant._with(Bf=plant.Bf * sparse, C=plant.C * (rng.random(plant.C.shape) < 0.7))
    plant = plant.with_sensor_faults([0]) if rng.random() < 0.5 else plant
    found = rs.diagnosability(plant)
    apart = found.detectable.all() and len(found.groups) == len(plant.faults)
    return plant if apart and len(attainable(plant).digits) <= 14 else None


plant_number = nth(small)


@pytest.mark.parametrize("quality", ["strong", "weak"])
@pytest.mark.parametrize("k", range(30))
def test_no_subset_is_better(k: int, quality: str) -> None:
    plant = plant_number(k)
    expected = best(attainable(plant).coding_set.structure, quality)
    found = choose(plant, quality=quality)
    assert expected is not None
    assert RANK[found.quality] >= RANK[quality]
    assert (len(found.residuals), *aims(found.structure)) == expected
    assert not any("time limit" in note for note in found.notes)


@pytest.mark.parametrize("k", range(15))
@pytest.mark.refusals(at_most=0)
def test_a_bank_takes_what_was_chosen(k: int, refused: Refused) -> None:
    plant = plant_number(k)
    found = choose(plant)
    try:
        bank = rs.design.structured_bank(plant, found)
    except rs.errors.AccuracyError as error:
        refused.skip(error)
    np.testing.assert_array_equal(bank.structure, found.structure)
    assert bank.strongly_isolating


def test_gertlers_plant_gets_the_canonical_set() -> None:
    found = choose(rs.library.gertler(sensor_faults=True))
    assert set(found.digits) == {"0111", "1011", "1101", "1110"}
    assert found.canonical
    assert found.quality == "strong"
    assert choose(rs.library.gertler()).digits in (("01", "10"), ("10", "01"))


def twins() -> rs.Plant:
    plant = rs.Plant(-np.eye(3), np.eye(3)[:, :1], np.eye(3)[:2])
    return plant.with_faults({"a": [1, 0, 0], "b": [0, 1, 0], "a2": [3, 0, 0], "hidden": [0, 0, 1]})


def test_what_no_method_separates_shares_a_code() -> None:
    found = choose(twins())
    assert found.inseparable == (("a", "a2"),)
    assert found.undetectable == ("hidden",)
    assert (found.quality, found.quality_of_groups) == ("none", "strong")
    np.testing.assert_array_equal(found.structure[:, 0], found.structure[:, 2])
    assert not found.structure[:, 3].any()
    for name, why in (("a", "distinguishes it from a2"), ("hidden", "no residual sees it")):
        with pytest.raises(DesignError, match=why):
            choose(twins(), require=name)
    assert choose(twins(), require="b").quality_of_groups == "strong"


@pytest.mark.parametrize("k", range(12))
def test_required_faults_are_told_from_all_others(k: int) -> None:
    plant = plant_number(k)
    name = plant.faults[k % len(plant.faults)]
    found = choose(plant, require=[name])
    assert len(found.residuals) <= len(choose(plant).residuals)
    own = found.structure[:, plant.faults.index(name)]
    for other, code in zip(plant.faults, found.structure.T, strict=True):
        assert code.any()
        if other != name:
            assert (own & ~code).any()
            assert (code & ~own).any()


def test_ignored_faults_are_ignored() -> None:
    plant = rs.library.gertler(sensor_faults=True)
    found = choose(plant, ignore="p1")
    assert found.ignored == ("p1",)
    assert not found.structure[:, 0].any()
    assert found.inseparable == (("p2", "y1 sensor", "y2 sensor"),)  # one residual is left
    np.testing.assert_array_equal(rs.design.structured_bank(plant, found).structure, found.structure)
    with pytest.raises(DesignError, match="sees any fault"):
        choose(plant, ignore=["p1", "p2"])
    with pytest.raises(DesignError, match="to be ignored"):
        choose(plant, ignore="p1", require="p1")


@pytest.mark.parametrize("k", range(12))
def test_fewer_residuals_than_strong_isolation_takes(k: int) -> None:
    plant = plant_number(k)
    strong, weak = choose(plant), choose(plant, quality="weak")
    fewer = len(strong.residuals) - 1
    if fewer >= len(weak.residuals):
        found = choose(plant, max_residuals=fewer)
        assert found.quality == "weak"
        assert len(found.residuals) <= fewer
        assert found.notes[0].startswith(f"weakly isolating only: strongly takes {len(strong.residuals)} residuals")
    if len(weak.residuals) > 1:
        with pytest.raises(DesignError, match=f"takes {len(weak.residuals)}"):
            choose(plant, max_residuals=len(weak.residuals) - 1)


def test_constant_faults_may_allow_weak_isolation_only() -> None:
    """Times s + 1 the faults are (1, 0, 0), (1, s, 0), (0, 1, s): at s = 0 what spans the first two holds the third."""
    plant = rs.Plant(-np.eye(3), np.eye(3)[:, :1], np.eye(3))
    plant = plant.with_faults({"a": [1, 0, 0], "b": ([1, -1, 0], [0, 1, 0]), "c": ([0, 1, -1], [0, 0, 1])})
    loose, lasting = choose(plant), choose(plant, constant=True)
    assert loose.quality == "strong"
    assert lasting.inseparable == (("a", "b"),)
    assert lasting.quality_of_groups == "weak"
    assert set(lasting.digits) == {"110", "111"}
    assert lasting.degradations == {"a": ("c",), "b": ("c",)}
    assert lasting.notes[0].startswith("weakly isolating only: no attainable row sees 'c' and ignores 'a' or 'b'")
    assert "constant" in lasting.notes[-1]


def test_what_the_time_limit_left_open_is_told() -> None:
    rng = np.random.default_rng(7)
    plant = random_plant(rng, n=8, outputs=5, inputs=3, faults=4).with_actuator_faults().with_sensor_faults()
    found = choose(plant, time_limit=0.05)
    assert found.quality == "strong"
    assert any("time limit" in note for note in found.notes)


@pytest.mark.parametrize(
    "wrong", [{"quality": "perfect"}, {"max_residuals": 0}, {"max_residuals": True}, {"time_limit": 0}]
)
def test_settings_that_make_no_sense(wrong: dict) -> None:
    with pytest.raises(SettingError):
        choose(rs.library.gertler(), **wrong)


def test_sperners_bound_is_reached_where_all_rows_are_attainable() -> None:
    """Six faults that residuals can see in any combination: four residuals, two ones each."""
    plant = rs.Plant(-np.eye(6), np.eye(6)[:, :1], np.eye(6)).with_faults({f"f{i}": np.eye(6)[i] for i in range(6)})
    found = choose(plant)
    assert isinstance(found, CodingSet)
    assert len(attainable(plant).digits) == 2**6 - 1
    assert len(found.residuals) == 4
    assert found.canonical
    assert found.distance == 2


def test_the_time_limit_is_that_of_all_of_it() -> None:
    """Fourteen faults, thousands of rows: listing them takes a second or so, and the search gets what is left."""
    rng = np.random.default_rng(0)
    A = rng.standard_normal((20, 20))
    plant = rs.Plant(
        A * 0.9 / np.abs(np.linalg.eigvals(A)).max(), np.eye(20)[:, :2], rng.standard_normal((6, 20)), dt=1
    )
    plant = plant.with_sensor_faults().with_actuator_faults()
    plant = plant.with_faults({f"c{i}": rng.standard_normal(20) for i in range(6)})
    begun = time.process_time()
    listed = len(attainable(plant).digits)
    listing = time.process_time() - begun
    assert listed > 3000
    limit = 2 * listing + 4.0
    for attempt in range(3):  # of a machine that is busy with something else one may take longer
        begun = time.perf_counter()
        found = choose(plant, time_limit=limit)
        if time.perf_counter() - begun < 1.15 * limit:
            break
        assert attempt < 2, "longer than its limit, three times"
    assert found.quality == "strong"
    assert any("time limit" in note for note in found.notes)


def drive() -> rs.Plant:
    """Two masses on a shaft, with the torque of the motor and a brake: at rest the shaft carries the torque alone."""
    A = [[-3.0, 2.5, -50.0, 50.0], [0.625, -0.875, 12.5, 0.0], [60.0, -60.0, 0.0, 0.0], [0.0, 0.0, 0.0, -100.0]]
    plant = rs.Plant(A, [[0, 0], [0, -12.5], [0, 0], [100, 0]], np.eye(4)[:3])
    return plant.with_actuator_faults().with_sensor_faults().with_faults({"bearing": [-50.0, 0, 0, 0]})


def test_codes_that_do_not_last_are_told() -> None:
    plant = drive().discretize(0.005)
    found = choose(plant)
    assert found.quality == "strong"
    (note,) = (note for note in found.notes if "once constant" in note)
    assert note.startswith("once constant, ")
    assert "'u1 actuator'" in note
    assert "'bearing'" in note
    assert "constant=True chooses residuals that answer for as long as a fault lasts" in note
    test = codes_of(rs.design.structured_bank(plant, found).generator, Structured())
    assert any(test.settled)
    assert not test.strongly_isolating
    assert not any("once constant" in note for note in choose(plant, constant=True).notes)
    assert not any("once constant" in note for note in choose(rs.library.gertler(sensor_faults=True)).notes)
