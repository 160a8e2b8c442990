"""The word of a verdict: its fits against a textbook selection, its guards one by one, the same in all units."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any, cast

import numpy as np
import pytest

import residua as rs
from residua.decide import explanation
from residua.decide.explanation import _fits
from residua.monitor import Diagnosis
from residua.monitor.alarms import word_of

NAMES = ("level", "flow")


def plant(of_y: float = 1.0, faults: bool = True) -> rs.Plant:
    C = of_y * np.eye(2)
    made = rs.Plant([[0.9, 0.05], [0.3, 0.6]], [[0.1], [0.2]], C, dt=1, outputs=NAMES, inputs=["valve"])
    made = made.with_sensor_faults(None if faults else ["flow"])
    return made.with_noise(process=1e-4 * np.eye(2), measurement=1e-2 * of_y**2 * np.eye(2))


def recorded(rows: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, (rows // 50, 1)), 50, axis=0)
    return u, plant().system(("control", "noise")).simulate(np.hstack([u, rng.standard_normal((rows, 4))]))


@cache
def monitor(of_y: float = 1.0, faults: bool = True) -> rs.Monitor:
    u, y = recorded(5000, 0)
    return rs.Monitor(rs.design.kalman_filter(plant(of_y, faults))).fit(u, of_y * y)


def word(course: np.ndarray, *, of_y: float = 1.0, faults: bool = True, which: int = 0) -> rs.decide.Word:
    """The word for the longest alarm of a recording in which a sensor is off by a course from row 600 on."""
    u, y = recorded(1000, 1)
    y[1000 - len(course) :, which] += course
    found = cast(Diagnosis, monitor(of_y, faults).run(u, of_y * y))
    assert found.main_alarm.word is not None
    return found.main_alarm.word


def left_of(atoms: list[np.ndarray], values: np.ndarray) -> float:
    """The sum of squares that least squares leaves."""
    columns = np.array(atoms).T
    return float(np.sum((values - columns @ np.linalg.lstsq(columns, values)[0]) ** 2))


def test_the_terms_are_those_of_a_textbook_selection() -> None:
    rng = np.random.default_rng(3)
    n, before, k = 90, 40, 2
    responses = np.cumsum(rng.standard_normal((3, n, k)) * 0.8 ** np.arange(n)[:, None], axis=1)
    usable = rng.random(n) > 0.1
    e = np.where(usable[:, None], rng.standard_normal((n, k)), 0.0)
    e[60:] += 3 * responses[1, : n - 60] * usable[60:, None]
    made = _fits(e, usable, responses, before)
    for f, response in enumerate(responses):
        atoms = []
        for shape in (response, np.cumsum(response, axis=0)):
            for start in range(n):
                if start % 4 == 0 or (shape is response and start >= before - 24):
                    atom = np.zeros((n, k))
                    atom[start:] = shape[: n - start]
                    atoms.append((atom * usable[:, None]).ravel())
        chosen: list[np.ndarray] = []
        left, fell = e.ravel(), 0.0
        for _ in range(12):
            squares = [left_of([*chosen, atom], e.ravel()) for atom in atoms]
            best = int(np.argmin(squares))
            if float(left @ left) - squares[best] < 16:
                break
            chosen.append(atoms[best])
            left = e.ravel() - np.array(chosen).T @ np.linalg.lstsq(np.array(chosen).T, e.ravel())[0]
            fell = float(e.ravel() @ e.ravel() - left @ left)
        assert made.terms[f] == len(chosen)
        assert made.evidence[f] == pytest.approx(fell, rel=1e-6, abs=1e-6)
        np.testing.assert_allclose(made.remainder[f].ravel(), left, atol=1e-6)


def test_a_listed_fault_is_a_good_match_with_its_size() -> None:
    said = word(np.full(400, 0.5))
    assert (said.kind, said.faults) == ("good match", (("level sensor",),))
    assert abs(said.size - 0.5) < 4 * said.deviation
    assert said.share > 0.95


@pytest.mark.parametrize("of_y", [1e-6, 1e5])
def test_words_are_the_same_in_all_units(of_y: float) -> None:
    for course in (np.full(400, 0.3), np.linspace(0, 1, 400), 0.5 * np.sin(np.arange(400.0) / 3)):
        one, other = word(course), word(course, of_y=of_y)
        assert (one.kind, one.faults, one.unlisted) == (other.kind, other.faults, other.unlisted)
        assert other.share == pytest.approx(one.share, abs=1e-6)


def test_what_nobody_listed_is_no_good_match() -> None:
    said = word(np.full(400, 0.5), faults=False)
    assert said.kind == "poor match"
    assert said.unlisted == "level sensor"


def word_with(monkeypatch: pytest.MonkeyPatch, faults: bool, best: str, levels: dict[str, float]) -> rs.decide.Word:
    """The word for a step of the best sensor, where faults have so much more evidence than its 1000, others none."""
    u, y = recorded(1000, 1)
    y[600:, NAMES.index(best.removesuffix(" sensor"))] += 0.5
    found = cast(Diagnosis, monitor(faults=faults).run(u, y))
    assert found.explainer is not None
    assert found.main_alarm is not None
    explainer = replace(found.explainer, colour=())
    names = [group[0] for group in explainer._responses[1]]

    def fits(*args: Any) -> explanation._Fits:
        evidence = np.array([1000 + levels[name] if name in levels else 0.0 for name in names])
        return replace(_fits(*args), evidence=evidence, terms=np.ones(len(names), dtype=np.int64))

    monkeypatch.setattr(explanation, "_fits", fits)
    return word_of(found.main_alarm, found.residuals, found.decided, explainer)


@pytest.mark.parametrize(
    ("other", "more", "kind", "unlisted"),
    [
        ("level sensor", -31, "good match", ""),
        ("level sensor", -29, "either", "level sensor"),
        ("level sensor", 31, "poor match", "level sensor"),
        ("valve actuator", -29, "either", "valve actuator"),
        ("state x1", -1, "good match", ""),
        ("state x1", 1, "either", "state x1"),
        ("state x1", 31, "poor match", "state x1"),
    ],
)
def test_an_unlisted_state_must_explain_more_and_a_sensor_about_as_much(
    monkeypatch: pytest.MonkeyPatch, other: str, more: float, kind: str, unlisted: str
) -> None:
    said = word_with(monkeypatch, False, "flow sensor", {"flow sensor": 0, other: more})
    assert (said.kind, said.faults, said.unlisted) == (kind, (("flow sensor",),), unlisted)


def test_a_sensor_behind_a_state_counts_by_its_own_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    said = word_with(monkeypatch, False, "flow sensor", {"flow sensor": 0, "state x1": -1, "level sensor": -29})
    assert said.kind == "either"


def test_a_state_within_reach_is_named_beside_two_listed_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    levels = {"flow sensor": 0.0, "level sensor": -1, "state x1": -2}
    said = word_with(monkeypatch, True, "flow sensor", levels)
    assert (said.kind, said.faults) == ("either", (("flow sensor",), ("level sensor",)))
    assert said.unlisted == "state x1"


def test_a_sensor_that_stands_still_leaves_less_than_noise() -> None:
    u, noise = np.zeros((1000, 1)), np.random.default_rng(7).standard_normal((1000, 4))
    y = plant().system(("control", "noise")).simulate(np.hstack([u, noise]))
    y[600:] = [0.5, 0.0]
    found = cast(Diagnosis, monitor().run(u, y))
    assert found.main_alarm.word.kind == "poor match"
    assert found.main_alarm.word.quieter


def test_more_noise_is_no_fault() -> None:
    assert word(0.3 * np.random.default_rng(5).standard_normal(400)).kind == "poor match"


@pytest.mark.parametrize("course", [np.r_[3.0, np.zeros(399)], np.full(999, 0.5), np.full(30, 0.5)])
def test_a_spike_a_start_and_a_short_alarm_are_too_early(course: np.ndarray) -> None:
    said = word(course)
    assert said.kind == "too early"
    assert said.from_start == (len(course) > 900)


def test_listed_faults_are_hardly_ever_poor_where_there_is_no_error_of_the_model() -> None:
    """The count of what the guards refuse: of forty faults of many sizes."""
    kinds = [word(np.full(400, size), which=which).kind for size in np.geomspace(0.1, 5, 20) for which in (0, 1)]
    assert kinds.count("poor match") <= 1
    assert kinds.count("good match") >= 30
