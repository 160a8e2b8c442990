"""The two global searches: known minima, seeds, interruptions, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from residua.design import DifferentialEvolution, GeneticSearch
from residua.errors import DesignError, FileFormatError, SettingError
from residua.robust.estimators.genetic_search import _crossed, _mutated
from residua.robust.estimators.global_search import SearchBox

SEARCHES = [GeneticSearch(), DifferentialEvolution()]
ids = ["genetic", "differential evolution"]


def sphere(x):
    return ((x - 0.3) ** 2).sum(axis=1)


def rotated(x):
    turn = np.linalg.qr(np.random.default_rng(5).standard_normal((x.shape[1],) * 2))[0]
    return (((x - 0.2) @ turn) ** 2 * np.logspace(0, 3, x.shape[1])).sum(axis=1)


def rastrigin(x):
    return (x**2 - 10 * np.cos(2 * np.pi * x) + 10).sum(axis=1)


def largest(x):
    return np.abs(x - np.linspace(-1, 1, x.shape[1])).max(axis=1)


def observer(x, seed=11):
    """Sum of |h_k| of the error of a fourth-order observer; 1000 and its spectral radius where it is not stable."""
    rng = np.random.default_rng(seed)
    A, C, B, D = 0.5 * rng.standard_normal((4, 4)), rng.standard_normal((1, 4)), rng.standard_normal((4, 1)), 0.3
    F = A - x[:, :, None] * C
    radius = np.abs(np.linalg.eigvals(F)).max(axis=1)
    e, total = B - x[:, :, None] * D, np.full(len(x), D)
    with np.errstate(over="ignore", invalid="ignore"):
        rows, power = [np.broadcast_to(C, (len(x), 1, 4))], F
        for _ in range(19):
            rows.append(rows[-1] @ F)
            power = power @ F
        outputs = np.concatenate(rows, axis=1)  # C, C F, ..., C F^19, and F^20: 400 terms in 20 steps
        for _ in range(20):
            total = total + np.abs(outputs @ e).sum(axis=(1, 2))
            e = power @ e
    return np.where(radius < 0.98, total, 1e3 + radius)


PROBLEMS = {
    "sphere": (sphere, 6, 5.0, 0.0, 1e-3),
    "rotated ellipsoid": (rotated, 6, 5.0, 0.0, 0.05),
    "many minima": (rastrigin, 4, 5.12, 0.0, 1e-2),
    "largest of absolute values": (largest, 6, 5.0, 0.0, 1e-2),
}


@pytest.mark.parametrize("search", SEARCHES, ids=ids)
@pytest.mark.parametrize("name", PROBLEMS)
def test_known_minima(search, name):
    cost, d, reach, least, tolerance = PROBLEMS[name]
    found = replace(search, generations=400, patience=150).minimise(cost, [-reach] * d, [reach] * d)
    assert least <= found.cost <= least + tolerance
    assert found.cost <= found.unpolished
    assert cost(found.x[None])[0] == pytest.approx(found.cost, rel=1e-9, abs=1e-20)  # alone, not among others
    assert np.all(np.diff(found.history) <= 0)
    assert len(found.history) == found.generations + 1
    assert found.method in str(found)


@pytest.mark.parametrize("seed", range(8))
def test_searches_agree_on_the_norm_of_an_observer(seed):
    options = {"lower": [-3.0] * 4, "upper": [3.0] * 4, "start": [0.0] * 4}
    found = [search.minimise(lambda x: observer(x, seed), **options) for search in SEARCHES]
    assert found[0].unpolished == pytest.approx(found[1].unpolished, rel=0.02)
    assert found[0].cost == pytest.approx(found[1].cost, rel=0.01)
    assert found[0].cost < 100  # stable


def oblique(x):
    """Sum of absolute values along oblique directions, the steepest a hundred times as steep as the flattest."""
    turn = np.linalg.qr(np.random.default_rng(7).standard_normal((x.shape[1],) * 2))[0]
    return 1 + np.abs((x - 0.2) @ turn) @ np.logspace(-2, 0, x.shape[1])


@pytest.mark.parametrize("search", SEARCHES, ids=ids)
def test_narrow_valleys_that_lie_across_the_axes(search):
    for seed in range(3):
        found = replace(search, seed=seed, generations=400, patience=400).minimise(oblique, [-5.0] * 8, [5.0] * 8)
        assert found.unpolished < 1.01


@pytest.mark.parametrize("search", SEARCHES, ids=ids)
def test_seeds(search):
    search = replace(search, generations=15, polish=False)
    one, again, other = (replace(search, seed=seed).minimise(rastrigin, [-5] * 4, [5] * 4) for seed in (1, 1, 2))
    assert np.array_equal(one.x, again.x)
    assert np.array_equal(one.history, again.history)
    assert not np.array_equal(one.x, other.x)


@pytest.mark.parametrize("search", SEARCHES, ids=ids)
def test_starts_are_kept_and_the_box_is_not_left(search):
    seen = []

    def cost(x):
        seen.append(x.copy())
        return rastrigin(x)

    start = np.array([[0.01, -0.02, 0.0], [9.0, 9.0, 9.0]])  # the second lies outside
    found = replace(search, generations=5).minimise(cost, [-5] * 3, [5] * 3, start=start)
    assert found.cost <= rastrigin(start[:1])[0]
    points = np.vstack(seen)
    assert np.all(points >= -5)
    assert np.all(points <= 5)
    assert (points == start[0]).all(axis=1).any()
    assert (points == 5.0).all(axis=1).any()


@pytest.mark.parametrize("search", SEARCHES, ids=ids)
def test_costs_that_are_no_numbers(search):
    def half(x):
        return np.where(x[:, 0] < 0, np.nan, sphere(x))

    found = replace(search, generations=60).minimise(half, [-1, -1], [1, 1])
    assert found.cost < 1e-3
    with pytest.raises(DesignError, match="none of"):
        replace(search, generations=5).minimise(lambda x: np.full(len(x), np.nan), [-1, -1], [1, 1])
    with pytest.raises(SettingError, match="one real number per point"):
        search.minimise(lambda x: x, [-1, -1], [1, 1])


def test_progress_is_told():
    for search in SEARCHES:
        told = []
        replace(search, generations=6, polish=False).minimise(
            sphere, [-1, -1], [1, 1], progress=lambda *args, told=told: told.append(args)
        )
        assert [done for done, *_ in told] == sorted({done for done, *_ in told})
        assert all(total == 6 for _, total, _ in told)


class StoppedError(Exception):
    pass


def test_interrupted_search_ends_with_the_same_bits(tmp_path):
    search = GeneticSearch(population=20, generations=25, patience=100)
    path = tmp_path / "search.json"
    whole = search.minimise(observer, [-3.0] * 4, [3.0] * 4)

    def stop(done, *_):
        if done == 7:
            raise StoppedError

    with pytest.raises(StoppedError):
        search.minimise(observer, [-3.0] * 4, [3.0] * 4, checkpoint=path, progress=stop)
    again = search.minimise(observer, [-3.0] * 4, [3.0] * 4, checkpoint=path)
    assert np.array_equal(whole.x, again.x)
    assert np.array_equal(whole.history, again.history)
    assert whole.unpolished == again.unpolished
    once_more = search.minimise(observer, [-3.0] * 4, [3.0] * 4, checkpoint=path)
    assert np.array_equal(whole.x, once_more.x)
    longer = replace(search, generations=40)
    assert np.array_equal(
        longer.minimise(observer, [-3.0] * 4, [3.0] * 4, checkpoint=path).history,
        longer.minimise(observer, [-3.0] * 4, [3.0] * 4).history,
    )


def test_checkpoints_of_other_searches_are_refused(tmp_path):
    path = tmp_path / "search.json"
    search = GeneticSearch(population=20, generations=3)
    search.minimise(sphere, [-1, -1], [1, 1], checkpoint=path)
    for other, cost, low, word in (
        (replace(search, seed=1), sphere, [-1, -1], "seed"),
        (replace(search, population=21), sphere, [-1, -1], "population"),
        (search, rastrigin, [-1, -1], "cost"),
        (search, sphere, [-2, -1], "lower"),
    ):
        with pytest.raises(SettingError, match=word):
            other.minimise(cost, low, [1, 1], checkpoint=path)
    with pytest.raises(SettingError, match="start"):
        search.minimise(sphere, [-1, -1], [1, 1], start=[[0, 0]], checkpoint=path)

    def feasible_near_the_corner_only(weight):
        return lambda x: np.where((x > 0.85).all(axis=1), weight * (1 + sphere(x)), 1e3)

    corner = tmp_path / "corner.json"
    options = {"start": [[0.9, 0.9]], "checkpoint": corner}
    search.minimise(feasible_near_the_corner_only(1.0), [-1, -1], [1, 1], **options)
    with pytest.raises(SettingError, match="another cost now"):  # which no point of the fingerprint sees
        search.minimise(feasible_near_the_corner_only(2.0), [-1, -1], [1, 1], **options)
    content = json.loads(path.read_text())
    for damage in ("{", "[]", json.dumps(content | {"points": [["x"]]}), json.dumps(content | {"costs": []})):
        path.write_text(damage)
        with pytest.raises(FileFormatError, match="delete it"):
            search.minimise(sphere, [-1, -1], [1, 1], checkpoint=path)


@pytest.mark.parametrize(
    "settings",
    [{"population": 1}, {"generations": 0}, {"seed": -1}, {"patience": 2.5}, {"polish": "yes"}],
)
@pytest.mark.parametrize("kind", [GeneticSearch, DifferentialEvolution], ids=ids)
def test_wrong_settings(kind, settings):
    with pytest.raises(SettingError):
        kind(**settings)
    for wrong in ({"crossover": 1.5}, {"mutation": -0.1}, {"selection": 0.0}):
        with pytest.raises(SettingError):
            GeneticSearch(**wrong)
    for low, high in (([0], [0]), ([0, 0], [1]), ([np.inf], [1]), ("a", [1])):
        with pytest.raises(SettingError):
            kind().minimise(sphere, low, high)


@given(st.integers(0, 2**31), st.integers(1, 6), st.floats(1e-3, 1e3))
def test_operators_stay_in_the_box(seed, d, width):
    rng = np.random.default_rng(seed)
    low = rng.standard_normal(d) * width
    box = SearchBox(sphere, low, low + width)
    points = box.first_population(rng, 12)
    assert np.all(points >= box.lower)
    assert np.all(points <= box.upper)
    moved = _mutated(rng, points, box)
    assert np.all(moved >= box.lower)
    assert np.all(moved <= box.upper)
    assert np.all((moved != points).any(axis=1) | (moved == points).all(axis=1))
    children = _crossed(rng, points[:6], points[6:])
    # arithmetic and BLX-0.5 children lie within 1.5 distances of the better parent, heuristic ones within 2
    reach = np.abs(points[:6] - points[6:])
    assert np.all(np.abs(children - points[:6]) <= 2.0 * reach + 1e-9 * width)


def test_ranking_prefers_the_better():
    search = GeneticSearch(selection=0.1)
    mates = np.stack([search._mates(np.random.default_rng(k), 20) for k in range(2000)])
    assert np.all(mates != np.arange(20))
    counts = np.bincount(mates.ravel(), minlength=20)
    assert counts[0] > counts[5] > counts[15] > 0


def test_no_point_is_replaced_by_a_worse_one(tmp_path):
    path = tmp_path / "search.json"
    costs = []
    for generations in range(1, 8):
        search = GeneticSearch(population=12, generations=generations, polish=False)
        search.minimise(rastrigin, [-5] * 3, [5] * 3, checkpoint=path)
        costs.append(json.loads(path.read_text())["costs"])
    assert np.all(np.diff(costs, axis=0) <= 0)
    assert np.all(np.diff(costs, axis=1) >= 0)
