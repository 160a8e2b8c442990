"""The tables of learnt monitors hold their promises, and a part of the campaign comes out."""

from __future__ import annotations

import csv
import importlib
import math
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "docs" / "data"
#: Sets of the part of the campaign that runs here: each of its own kind, and with few sensors.
PART = ("blind", "two rooms", "motor")


@pytest.fixture
def campaign(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module("learnt_monitors")


def table(name: str, header: tuple[str, ...]) -> list[dict[str, str]]:
    with (DATA / name).open(encoding="utf-8", newline="") as file:
        reader = csv.DictReader(file)
        rows = list(reader)
    assert tuple(reader.fieldnames or ()) == header
    return rows


# ----------------------------------------------------------------------- the tables


def test_faults_are_seen_as_promised(campaign: ModuleType) -> None:
    rows = table("learnt_monitors.csv", campaign.HEADER)
    assert [row["set"] for row in rows] == [one.name for one in campaign.SETS]
    three = {row["set"]: float(row["seen at 3"]) for row in rows}
    assert np.mean(list(three.values())) >= 0.9
    assert min(share for name, share in three.items() if name != "blind") >= 0.9
    own, default = (np.mean([float(row[name]) for row in rows]) for name in ("seen", "seen, default"))
    assert own > default
    assert np.mean([float(row["named"]) for row in rows]) >= 0.8


def test_sizes_are_printed_as_they_are_measured(campaign: ModuleType) -> None:
    rows = table("learnt_monitors.csv", campaign.HEADER)
    for kind in ("soon", "lasting"):
        close = [campaign.within(float(row[kind])) for row in rows]
        assert [row[f"{kind} within 1.5"] == "yes" for row in rows] == close
        assert sum(close) >= 9, kind


def test_false_alarms_are_those_of_the_table(campaign: ModuleType) -> None:
    """Nine of ten within three times the rate are asked for, of one log each; of one of three it is eight."""
    rows = table("learnt_monitors.csv", campaign.HEADER)
    logs = ["false", *(f"false, log {seed}" for seed in campaign.OTHER_LOGS)]
    kept = [sum(float(row[name]) <= 3 for row in rows) for name in logs]
    assert min(kept) >= 8
    assert sum(kept) >= 26  # of 30
    assert max(float(row[name]) for row in rows for name in logs) < max(float(row["false, default"]) for row in rows)


def test_events_are_found_as_promised(campaign: ModuleType) -> None:
    rows = table("learnt_events.csv", campaign.EVENTS)
    turbine = [row for row in rows if row["plant"] == "wind turbine"]
    assert len(turbine) == 4
    for row in turbine:
        assert (row["events"], row["found"]) == ("29", "29"), row
        assert float(row["false"]) <= (0.004 if "pitch" in row["case"] else 0.002), row
        assert float(row["outlasts, median"]) <= 20, row
    hidden = {row["case"]: row for row in rows if row["plant"] == "hidden sensor"}
    assert set(hidden) == {"stuck at 0", "off by 5 deviations"}
    for row in hidden.values():
        assert row["found"] == row["events"]
        assert float(row["delay"]) < 100
        assert float(row["false"]) <= campaign.RATE
    assert float(hidden["stuck at 0"]["least share"]) > 0.95


# ------------------------------------------------------------- a part of the campaign


def test_a_hidden_sensor_that_sticks_or_is_off_is_seen(campaign: ModuleType) -> None:
    stuck, offset = campaign.hidden_rows()
    assert stuck == {**stuck, "form": "static", "events": 10, "found": 10}
    assert stuck["delay"] < 10
    assert float(stuck["least share"]) > 0.95
    assert (offset["found"], offset["delay"]) == (10, 0)
    assert float(offset["share"]) > 0.6
    assert float(stuck["false"]) <= campaign.RATE


def test_every_stop_and_curtailment_of_a_turbine_is_found(campaign: ModuleType) -> None:
    (row,) = campaign.turbine_rows([(False, ["wind"])])
    assert (row["form"], row["events"], row["found"]) == ("curve", 29, 29)
    assert float(row["share"]) > 0.9
    assert float(row["false"]) <= 0.002
    assert float(row["outlasts, median"]) <= 20


@pytest.fixture
def part(campaign: ModuleType) -> list[dict[str, Any]]:
    scale = campaign.Scale(log=4000, quiet=10_000, rows=1500, onset=500, recordings=1, runs=3, before=200)
    return [campaign.row_of(one, scale) for one in campaign.SETS if one.name in PART]


def test_a_part_of_the_campaign_comes_out(campaign: ModuleType, part: list[dict[str, Any]]) -> None:
    """With half of the rows: fewer faults are seen, and more rows are in alarm."""
    assert [row["set"] for row in part] == list(PART)
    for row in part:
        assert set(row) == set(campaign.HEADER)
        assert float(row["false"]) <= 20, row
        for kind in ("soon", "lasting"):
            assert 0.5 <= float(row[kind]) <= 2, row
    by_name = {row["set"]: row for row in part}
    for name in ("two rooms", "motor"):
        assert float(by_name[name]["seen at 3"]) >= 0.9
        assert float(by_name[name]["named"]) >= 0.8
    assert float(by_name["blind"]["seen"]) > float(by_name["blind"]["seen, default"])
    assert len(list(campaign.targets(part, []))) == 6


# ------------------------------------------------------------------ how it is counted


def test_rows_of_an_alarm_that_outlasts_an_event_are_not_false(campaign: ModuleType) -> None:
    alarm = np.zeros(1000, bool)
    alarm[[50, 51]] = True  # false
    alarm[103:125] = True  # an event from 100 to 120, seen late, and five rows after it
    alarm[300:302] = True  # false, before the second event, which nothing sees
    found = campaign.of_events(alarm, [(100, 120, "stop"), (400, 410, "stop")])
    assert (found["events"], found["found"], found["delay"]) == (2, 1, "3")
    assert (found["share"], found["least share"]) == ("0.425", "0.000")
    assert (found["outlasts, median"], found["outlasts, largest"]) == ("2.5", 5)
    assert float(found["false"]) == pytest.approx(4 / (1000 - 30 - 5), abs=1e-5)
    alarm[405:] = True
    assert campaign.of_events(alarm, [(400, 410, "stop")])["outlasts, largest"] == 590


@pytest.mark.parametrize("needed", [1e-3, 0.7, 3.0, 60.0])
def test_the_smallest_size_is_found_from_any_guess(campaign: ModuleType, needed: float) -> None:
    for guess in (1e-5, 0.5, 3.0, 1e4, math.inf):
        found = campaign.smallest(lambda size: 0.5 + 0.4 * (size >= needed), guess, 1.0)
        assert found == pytest.approx(needed, rel=0.03)
    assert campaign.smallest(lambda size: 0.5, 1.0, 1.0) == math.inf


def test_printed_sizes_are_compared_with_measured_ones(campaign: ModuleType) -> None:
    assert campaign.ratio(3.0, 2.0) == 1.5
    assert campaign.ratio(math.inf, math.inf) == 1.0
    assert campaign.ratio(3.0, math.inf) == 0.0
    assert [campaign.within(one) for one in (0.6, 0.67, 1.5, 1.51, math.inf)] == [False, True, True, False, False]


def test_targets_say_what_is_missed(campaign: ModuleType) -> None:
    good = {"seen at 3": "0.95", "false": "2.5", "soon within 1.5": "yes", "lasting within 1.5": "yes"}
    good |= {f"false, log {seed}": "0.0" for seed in campaign.OTHER_LOGS}
    assert all(held for _, held in campaign.targets([good] * 10, []))
    noisy = [good] * 8 + [good | {"false": "3.5", "seen at 3": "0.2"}] * 2
    assert [held for _, held in campaign.targets(noisy, [])] == [False, False, True, True, True, True]
    turbine = {"plant": "wind turbine", "case": "wind, power", "events": 29, "found": 29, "false": "0.00300"}
    assert [held for _, held in campaign.targets([], [turbine, turbine | {"case": "pitch"}])] == [False, True]
    hidden = {"plant": "hidden sensor", "case": "", "events": 2, "found": 2, "false": "0", "delay": 9, "share": "0.96"}
    changes: tuple[dict[str, Any], ...] = ({}, {"delay": 100}, {"false": "0.1"}, {"found": 1})
    held = [held for _, held in campaign.targets([], [hidden | change for change in changes])]
    assert held == [True, False, False, False]
