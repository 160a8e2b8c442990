"""Names by responses beside any test: the same bits however time is cut, and the right fault."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

import residua as rs
from residua.decide import (
    CUSUM,
    EWMA,
    GLR,
    Matched,
    MultiscaleEWMA,
    NormThreshold,
    PeakThreshold,
    matched,
    whitening_matrix,
)
from residua.decide.isolation import Scores
from residua.decide.matched_recursion import empty_match, match_block, summed
from residua.decide.test import Block, Tested
from residua.decide.window import empty_window, moving_sum
from residua.errors import FileFormatError, SettingError
from residua.export import to_c
from residua.library import simulate_three_tank
from residua.monitor.running import Decisions, joined_decisions


def tank() -> rs.Plant:
    A = [[-0.015769, 0, 0.015769], [0, -0.022714, 0.015087], [0.015769, 0.015087, -0.030856]]
    plant = rs.Plant(A, [[0.0064935, 0], [0, 0.0064935], [0, 0]], np.eye(3), inputs=["Q1", "Q2"])
    plant = plant.with_operating_point(inputs=[21.4, 53.8], outputs=[41.0, 32.0, 36.6]).with_sensor_faults()
    plant = plant.with_faults({"leak 1": [-1, 0, 0], "leak 3": [0, 0, -1], "clog 32": [0, -1, 1]})
    return plant.discretize(1.0).with_noise(process=1e-4, measurement=0.02)


def monitor(test: rs.decide.TestSettings) -> rs.Monitor:
    normal = simulate_three_tank(4000, seed=5)
    watch = rs.Monitor(rs.design.kalman_filter(tank()), test=test, isolate=Matched(window=40))
    return watch.fit(normal.u, normal.y, false_alarm_rate=1e-3)


def diagnosed(watch: rs.Monitor, u: np.ndarray, y: np.ndarray) -> rs.Diagnosis:
    found = watch.run(u, y)
    assert isinstance(found, rs.Diagnosis)
    return found


def faulty(name: str) -> tuple[np.ndarray, np.ndarray]:
    start = np.arange(700) >= 300
    if name.endswith("sensor"):
        found = simulate_three_tank(700, seed=1)
        y = found.y.copy()
        y[:, int(name[1]) - 1] += 1.0 * start
        return found.u, y
    found = simulate_three_tank(700, faults={name: 0.1 * start}, seed=1)
    return found.u, found.y


def beside(window: int, *, steady: bool = False) -> matched.NamesBeside:
    """Return names beside a test that knows the noise of the plant."""
    watch = rs.Monitor(rs.design.kalman_filter(tank()), test=CUSUM(), isolate=Matched(window, steady))
    names = watch._specification().isolation
    assert isinstance(names, matched.NamesBeside)
    return names


def random_outcome(rng: np.random.Generator, plants: int, time: int) -> Tested:
    """Return what some test may say: alarms of any length, over the threshold or not, with gaps."""
    shape = (plants, time)
    usable = np.repeat(rng.random((plants, time // 4)) < 0.85, 4, axis=1)
    alarm = np.repeat(rng.random((plants, time // 8)) < 0.4, 8, axis=1)
    alarm[0, time // 2 :] = True
    exceeded = (rng.random(shape) < 0.6) & usable
    q = 2.0 * rng.standard_normal((*shape, 3)) * usable[..., None]
    nobody = np.zeros((*shape, 0))
    up = np.zeros(shape, dtype=np.int64)
    return Tested(usable, np.ones(shape), exceeded, alarm, up, q, nobody, nobody.astype(bool))


def outcome_of(tested: Tested, plants: slice, samples: slice = slice(None)) -> Tested:
    names = [one.name for one in fields(tested) if one.name != "likelihood"]
    return Tested(**{name: getattr(tested, name)[plants, samples] for name in names})


def pieces_of(names: matched.NamesBeside, tested: Tested, cuts: list[int]) -> tuple[Scores, matched.BesideState]:
    """Return scores of all samples, run block by block, and the state after the last."""
    state, parts, done = names.start(len(tested.alarm)), [], 0
    for size in cuts:
        part = outcome_of(tested, slice(None), slice(done, done + size))
        state, scores = names.run(state, Block(part.whitened, part.usable, done), part)
        names.check_state(state, done + size)
        parts.append(scores)
        done += size
    return joined_decisions(parts), state


def arrays_in(whole: object) -> list[np.ndarray]:
    """Return all arrays of a dataclass of arrays, those of its parts too."""
    if isinstance(whole, np.ndarray):
        return [whole]
    return [] if whole is None else [a for one in fields(whole) for a in arrays_in(getattr(whole, one.name))]  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("test", [CUSUM(), EWMA(), GLR(), MultiscaleEWMA()], ids=lambda one: type(one).__name__)
@pytest.mark.parametrize("name", ["leak 3", "y2 sensor", "y3 sensor"])
def test_any_test_has_names_by_responses(test: rs.decide.TestSettings, name: str) -> None:
    found = diagnosed(monitor(test), *faulty(name))
    assert name in found.main_alarm.candidates[0].faults
    assert found.main_alarm.candidates[0].score > 0.7


def test_the_same_bits_however_time_is_cut_and_after_a_file(tmp_path: Path) -> None:
    watch = monitor(MultiscaleEWMA())
    u, y = faulty("leak 3")
    y[350:353, 1] = np.nan
    whole = diagnosed(watch, u, y)
    watch.reset()
    parts = [watch.update(u[a : a + 97], y[a : a + 97]) for a in range(0, 400, 97)]
    watch.save(tmp_path / "m.json")
    again = rs.Monitor.load(tmp_path / "m.json")
    parts.append(again.update(u[485:], y[485:]))
    assert np.array_equal(np.concatenate([one.scores for one in parts], axis=1)[0], whole.scores, equal_nan=True)
    again.reset()
    steps = [again.step(a, b) for a, b in zip(u, y, strict=True)]
    named = [one.candidates[0].faults for one in steps if one.alarm and one.candidates]
    assert named[-1] == whole.main_alarm.candidates[0].faults  # type: ignore[union-attr]
    fleet = rs.Fleet(again, plants=[1, 2])
    rows = np.array([u, u]), np.array([y, y])
    ran = fleet.update(*rows)
    assert isinstance(ran, Decisions)
    assert np.array_equal(ran.scores[0], whole.scores, equal_nan=True)


@pytest.mark.parametrize("steady", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_any_pattern_of_alarms_gives_the_same_bits_however_time_is_cut(seed: int, steady: bool) -> None:
    """Three plants, any alarms of any test, samples that are not usable: at once, in blocks, and one by one."""
    rng, time = np.random.default_rng(seed), 160
    names = beside(window=7, steady=steady)
    tested = random_outcome(rng, 3, time)
    whole, end = pieces_of(names, tested, [time])
    for cuts in ([1] * time, [50, 1, 0, 60, 49], [7, 8, 9, 136]):
        parts, last = pieces_of(names, tested, cuts)
        for one, other in zip(arrays_in(whole), arrays_in(parts), strict=True):
            np.testing.assert_array_equal(one, other)
        for one, other in zip(arrays_in(end), arrays_in(last), strict=True):
            np.testing.assert_array_equal(one, other)
    for plant in range(3):
        alone, _ = pieces_of(names, outcome_of(tested, slice(plant, plant + 1)), [time])
        for one, other in zip(arrays_in(whole), arrays_in(alone), strict=True):
            np.testing.assert_array_equal(one[plant], other[0])


@pytest.mark.parametrize("steady", [False, True])
def test_the_likelihoods_in_alarm_are_those_of_a_run_from_the_first_sample_on(steady: bool) -> None:
    """Products to the last bit; settled sums, which are added in another order, to rounding."""
    rng, time = np.random.default_rng(3), 200
    names = beside(window=9, steady=steady)
    test, tested = names.matched, random_outcome(rng, 2, time)
    sums, _ = moving_sum(summed(tested.whitened, tested.usable), empty_window(2, test.samples, 5))
    found, _ = match_block(test, empty_match(test, 2), tested.whitened, tested.usable, sums)
    scores, _ = pieces_of(names, tested, [time])
    match, loud = scores.match, tested.alarm
    dated = loud[..., None] & (found["ages"] >= 0) & (match.ages >= 0)
    assert steady or dated.any()
    for name in ("ratios", "ages", "sizes", "deviations"):
        np.testing.assert_array_equal(getattr(match, name)[dated], found[name][dated])
    np.testing.assert_allclose(match.ratios[loud], found["ratios"][loud], rtol=1e-9, atol=1e-12)
    assert np.isnan(scores.scores[~loud]).all()
    assert not match.ratios[~loud].any()
    assert (match.source[~loud] == -1).all()


def test_nothing_is_computed_without_an_alarm(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> None:
        raise AssertionError("no alarm stands")

    monkeypatch.setattr(matched, "likelihoods_of", never)
    tested = random_outcome(np.random.default_rng(0), 2, 80)
    tested.alarm[...] = False
    scores, state = pieces_of(beside(window=7), tested, [50, 30])
    assert np.isnan(scores.scores).all()
    assert not state.held.on.any()


def test_a_name_is_held_once_its_arrival_has_left_the_window() -> None:
    found = diagnosed(monitor(MultiscaleEWMA()), *faulty("y2 sensor"))
    late = slice(300 + 2 * 40 + 1, 690)
    assert found.alarm[late].all()
    assert len(np.unique(found.match.fault[late])) == 1
    assert len(np.unique(found.match.arrival[late])) == 1
    assert abs(found.match.arrival[late][0] - 300) <= 2
    assert (found.match.source[late] <= 300 + 40 + 1).all()
    assert found.main_alarm.onset == pytest.approx(300, abs=2)


def test_a_name_is_right_with_a_tenth_of_the_values_missing() -> None:
    u, y = faulty("y3 sensor")
    y[np.random.default_rng(2).random(y.shape) < 0.1] = np.nan
    found = diagnosed(monitor(MultiscaleEWMA()), u, y)
    assert "y3 sensor" in found.main_alarm.candidates[0].faults


def test_a_kalman_filter_without_a_test_keeps_the_default_and_matched_filters_their_own() -> None:
    assert isinstance(rs.Monitor(rs.design.kalman_filter(tank()), isolate=Matched()).test, MultiscaleEWMA)
    assert isinstance(rs.Monitor(rs.design.matched_filters(tank())).test, NormThreshold)
    by_likelihood = rs.Monitor(rs.design.kalman_filter(tank()), test=NormThreshold(), isolate=Matched())
    assert by_likelihood.norm_test.responses is not None


def test_a_test_that_does_not_whiten_is_named_by_the_noise_of_the_plant() -> None:
    """A given threshold on the norm of the residual as it is: sizes and names are those beside a test that whitens."""
    u, y = faulty("y2 sensor")
    watch = rs.Monitor(rs.design.kalman_filter(tank()), test=PeakThreshold(0.7), isolate=Matched(window=40))
    found = diagnosed(watch, u, y)
    assert found.main_alarm.candidates[0].faults == ("y2 sensor",)
    assert found.main_alarm.candidates[0].sizes[0].mean == pytest.approx(1.0, abs=0.1)
    names = watch._specification().isolation
    covariance = watch.generator.covariance
    assert isinstance(names, matched.NamesBeside)
    assert covariance is not None
    steady = watch.generator.steady_directions["y2 sensor"]
    column = names.matched.faults.index("y2 sensor")
    white = steady @ whitening_matrix(covariance)
    assert np.linalg.norm(names.matched.settled[:, column]) == pytest.approx(np.linalg.norm(white))
    np.testing.assert_allclose(abs(names.signatures[column].T @ steady), np.linalg.norm(steady))


def test_a_state_that_cannot_be_one_is_refused() -> None:
    names = beside(window=7)
    state = names.start(1)
    state.rows[0, 3] = 1.0
    with pytest.raises(FileFormatError, match="usable"):
        names.check_state(state, 5)


def test_pages_tables_and_what_is_refused_are_in_words(tmp_path: Path) -> None:
    watch = monitor(CUSUM())
    found = diagnosed(watch, *faulty("leak 3"))
    found.to_html(tmp_path / "page.html")
    assert "leak 3" in str(found)
    assert "leak 3" in (tmp_path / "page.html").read_text()
    with pytest.raises(SettingError, match="matched filters name a fault by its response"):
        watch.learn_fault("other", *faulty("leak 3"))
    with pytest.raises(SettingError, match="cannot be exported"):
        to_c(watch, tmp_path / "code", missing="hold")


def test_residuals_that_are_not_white_are_refused() -> None:
    design = rs.design.luenberger_observer(tank()).residual_generator()
    with pytest.raises(SettingError, match="white"):
        rs.Monitor(design, test=CUSUM(), isolate=Matched())
