"""Names by the channel that is furthest off, and the words that go with them."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import residua as rs
from channel_examples import M, fitted, log, plant
from residua.decide import ByChannel, ChannelRelations
from residua.decide.alarm import Candidate
from residua.decide.by_channel import channel_faults
from residua.decide.channel_relations import MODEL
from residua.decide.statement import too_short
from residua.decide.word import EITHER, POOR, TOO_EARLY
from residua.errors import SettingError

BEGIN = 300


def found(column: int, size: float, rows: int = 300, form: str = "static", raised: Any = ()) -> Any:
    """Return the diagnosis of a recording with one channel off by some of its deviations over some rows."""
    made = log(BEGIN + 300, 30).copy()
    made[BEGIN : BEGIN + rows, column] += size * log(3000)[:, column].std()
    return copy.deepcopy(fitted(form, raised)).run(made[:, :M], made[:, M:])


def longest(diagnosis: Any) -> Any:
    return max(diagnosis.alarms, key=lambda one: one.samples)


@pytest.mark.parametrize("form", ["static", "lags"])
@pytest.mark.parametrize(("column", "name"), [(0, "u actuator"), (1, "a sensor"), (2, "b sensor")])
def test_the_channel_that_is_off_is_named_first(column: int, name: str, form: str) -> None:
    alarm = longest(found(column, 8.0, form=form))
    first, *others = alarm.candidates
    assert first.faults == (name,)
    assert first.score == 1.0
    assert [one.score for one in alarm.candidates] == sorted([one.score for one in alarm.candidates], reverse=True)
    assert {one.name for one in (first, *others)} <= {"u actuator", "a sensor", "b sensor"}


def test_scores_are_parts_of_the_furthest_in_thresholds() -> None:
    diagnosis = found(1, 8.0)
    parts = diagnosis.parts.statistics[:, [2, 3, 1]]
    assert diagnosis.groups == (("a sensor",), ("b sensor",), ("u actuator",))
    known = np.isfinite(parts).any(axis=1)
    scores = np.nan_to_num(parts[known]) / np.nanmax(parts[known], axis=1, keepdims=True)
    assert np.allclose(diagnosis.scores[known], scores)
    alarm = longest(diagnosis)
    rows = parts[alarm.start : alarm.start + 100]
    mean = np.nansum(rows, axis=0) / np.maximum(np.isfinite(rows).sum(axis=0), 1)
    order = np.argsort(-mean)
    assert [one.faults for one in alarm.candidates] == [diagnosis.groups[k] for k in order][: len(alarm.candidates)]
    assert alarm.candidates[1].score == pytest.approx(mean[order[1]] / mean.max())


def test_a_name_by_channels_is_never_said_alone() -> None:
    diagnosis = found(1, 8.0)
    said = diagnosis.statement(replace(longest(diagnosis), word=None))
    assert said.confidence == EITHER
    assert said.lines == ("either a sensor or something not listed",)
    assert said.headline == "Fault found: either a sensor or something not listed, alarm raised at 300 s."
    assert said.sentences[0].startswith("Deviation from the other channels: a")
    assert "a sensor deviates most, b sensor " in said.sentences[0]
    assert "at least 0.6 times as much" in said.rules


def test_channels_that_are_as_far_off_are_named_too() -> None:
    names = tuple((name,) for name in ("a sensor", "b sensor", "u actuator"))
    candidates = tuple(Candidate(name, score, 0.0) for name, score in zip(names, (1.0, 0.85, 0.5), strict=True))
    diagnosis = found(1, 8.0)
    alarm = replace(longest(diagnosis), candidates=candidates, fired=("a", "b"), word=None)
    said = diagnosis.statement(alarm)
    assert said.lines == ("either a sensor, b sensor or something not listed",)
    assert said.sentences == (
        "Deviation from the other channels: a and b; a sensor deviates most, b sensor 85 % as far.",
    )


@pytest.mark.parametrize("column", [0, 1])
def test_of_two_sensors_that_say_the_same_both_are_named(column: int) -> None:
    """Nothing tells which one is off."""
    rng = np.random.default_rng(0)
    slow = np.cumsum(rng.standard_normal(4000)) / 20
    rows = np.column_stack([slow, slow]) + 0.1 * rng.standard_normal((4000, 2))
    learnt = rs.learn(rows[:3000], inputs=[], outputs=["one", "other"], progress=False)
    rows[3400:, column] += 2.0
    diagnosis: Any = learnt.monitor.run(None, rows[3000:])
    line = diagnosis.statement(longest(diagnosis)).lines[0]
    assert "one sensor" in line
    assert "other sensor" in line


def test_a_channel_may_be_called_model() -> None:
    rng = np.random.default_rng(0)
    slow = np.cumsum(rng.standard_normal(4000)) / 30
    rows = np.column_stack([slow, 2 * slow, -slow]) + 0.1 * rng.standard_normal((4000, 3))
    learnt = rs.learn(rows[:3000], inputs=[], outputs=["model", "b", "c"], progress=False)
    rows[3500:, 0] += 1.5
    diagnosis: Any = learnt.monitor.run(None, rows[3000:])
    assert diagnosis.named[0] == ("model sensor",)


def test_few_samples_are_too_early_for_a_name() -> None:
    rows = log(BEGIN + 3, 30).copy()
    rows[BEGIN:, 1] += 10.0
    diagnosis: Any = copy.deepcopy(fitted("static")).run(rows[:, :M], rows[:, M:])
    (alarm,) = diagnosis.alarms
    assert alarm.samples == 3
    said = diagnosis.statement(replace(alarm, word=None))
    assert said.confidence == TOO_EARLY
    assert said.lines == (f"too early to be sure of the name, for {too_short(5)}; so far a sensor",)


def test_an_alarm_of_the_model_alone_is_a_poor_match() -> None:
    diagnosis = found(1, 8.0, raised=(("u", 1e6), ("a", 1e6), ("b", 1e6)))
    alarm = longest(diagnosis)
    assert alarm.fired == (MODEL,)
    said = diagnosis.statement(replace(alarm, word=None))
    assert said.confidence == POOR
    assert said.headline.startswith(
        "A fault was found, alarm raised at 300 s, a poor match: no single channel deviates"
    )
    assert "only the model's prediction; nearest is" in said.lines[0]
    assert said.sentences[0].startswith("Deviation from the model's prediction only")


def test_faults_of_several_channels_are_never_named() -> None:
    more = plant().with_faults({"leak": [-1.0], "both": ([0.0], [1.0, 1.0])})
    assert channel_faults(rs.design.kalman_filter(more)) == {"a sensor": "a", "b sensor": "b", "u actuator": "u"}
    monitor = rs.Monitor(rs.design.kalman_filter(more), test=ChannelRelations(), isolate=ByChannel())
    monitor.fit(log(3000)[:, :M], log(3000)[:, M:])
    rows = log(600, 30).copy()
    rows[BEGIN:, 1] += 10.0
    diagnosis: Any = monitor.run(rows[:, :M], rows[:, M:])
    assert diagnosis.naming.unjudged == ("leak", "both")
    assert diagnosis.named[0] == ("a sensor",)


def test_single_rows_are_named_as_the_whole_is() -> None:
    rows = log(400, 30).copy()
    rows[BEGIN:, 2] += 10.0
    monitor = copy.deepcopy(fitted("static"))
    monitor.reset()
    scores = np.array([monitor.update(row[None, :M], row[None, M:]).scores[0, 0] for row in rows])
    diagnosis: Any = monitor.run(rows[:, :M], rows[:, M:])
    assert scores.tobytes() == diagnosis.scores.tobytes()


def test_another_test_is_refused() -> None:
    design = rs.design.kalman_filter(plant())
    with pytest.raises(SettingError, match="ByChannel names channels by the test ChannelRelations"):
        rs.Monitor(design, test=rs.decide.CUSUM(), isolate=ByChannel())


def test_it_says_how_it_names() -> None:
    assert found(1, 8.0).settings["isolation"] == (
        "the channel with the largest deviation in thresholds, over 100 samples at most"
    )
