"""A diagnosis as JSON: what was found for anybody, and all of it back with every bit; nothing else is read."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import residua as rs
from bank_examples import hand_made_bank, recording as bank_recording, sampled_plant
from residua.decide import CUSUM, Likelihood, Matched, NormThreshold
from residua.errors import DataError, FileFormatError
from residua.json_files import dumps
from residua.report.document import EDITED, Told


def plant(dt: float = 0.5) -> rs.Plant:
    made = rs.Plant([[0.8, 0.1], [0, 0.6]], [[0.2], [0.4]], np.eye(2), dt=dt, inputs=["pump"], outputs=["low", "high"])
    return made.with_sensor_faults().with_faults({"leak": [-1.0, 0.0]}).with_noise(process=1e-4, measurement=1e-2)


def rows(samples: int, size: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((samples, 1))
    faults = np.zeros((samples, 3))
    faults[samples // 2 : -samples // 5, 2] = size
    noise = rng.standard_normal((samples, len(plant().noises)))
    y = plant().system(("control", "fault", "noise")).simulate(np.hstack([u, faults, noise]))
    y[10:14, 1] = np.nan
    return u, y


def learnt(monitor: rs.Monitor) -> rs.Monitor:
    return monitor.learn_fault("seen before", *rows(400, 1.0, 3))


def continuous() -> rs.Monitor:
    made = rs.Plant([[-1.0]], [[1.0]], [[1.0], [1.0]], inputs=["pump"], outputs=["low", "high"]).with_sensor_faults()
    return rs.Monitor(rs.design.unknown_input_observer(made).residual_generator(), test=NormThreshold(threshold=1.0))


MONITORS: dict[str, Callable[[], rs.Monitor]] = {
    "default": lambda: rs.Monitor(rs.design.kalman_filter(plant())),
    "fitted": lambda: rs.Monitor(rs.design.kalman_filter(plant())).fit(*rows(900, 0.0, 1)),
    "CUSUM": lambda: rs.Monitor(rs.design.kalman_filter(plant()), test=CUSUM(threshold=4.0)),
    "groups": lambda: rs.Monitor(rs.design.kalman_filter(plant()), test=NormThreshold(groups="each")),
    "matched": lambda: rs.Monitor(rs.design.matched_filters(plant(), window=20)),
    "names by matched filters": lambda: rs.Monitor(rs.design.kalman_filter(plant()), isolate=Matched()),
    "likelihood": lambda: rs.Monitor(rs.design.kalman_filter(plant()), test=CUSUM(threshold=4.0), isolate=Likelihood()),
    "learnt": lambda: learnt(rs.Monitor(rs.design.kalman_filter(plant())).fit(*rows(900, 0.0, 1))),
    "no isolation": lambda: rs.Monitor(rs.design.kalman_filter(plant()), isolate=None),
    "estimator": lambda: rs.Monitor(rs.design.fault_estimator(plant(), faults=["leak"])),
    "continuous": continuous,
}


@cache
def found(kind: str, size: float = 1.5) -> rs.Diagnosis:
    if kind == "bank":
        watched = sampled_plant(0)
        u, y = bank_recording(watched, 400, faults={watched.faults[0]: 8.0}, start=200)
        made = rs.Monitor(hand_made_bank(watched)).run(u, y)
    else:
        made = MONITORS[kind]().run(*rows(500, size), dt=0.5, source="<here>")
    assert isinstance(made, rs.Diagnosis)
    return made


KINDS = (*MONITORS, "bank")


def same(one: Any, other: Any) -> bool:
    """Tell whether two values are the same, every number to its last bit."""
    if isinstance(one, np.ndarray):
        alike = (one.dtype, one.shape) == (other.dtype, other.shape)
        return alike and np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float):
        return one == other or (one != one and other != other)
    if is_dataclass(one):
        return type(one) is type(other) and all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    return type(one) is type(other) and one == other


@pytest.mark.parametrize("kind", KINDS)
def test_a_diagnosis_comes_back_with_every_bit(kind: str) -> None:
    one = found(kind)
    assert one.alarms or kind == "continuous"
    again = rs.Diagnosis.from_json(one.to_json())
    for field in fields(one):
        if field.name not in ("isolation", "generator", "explainer"):
            assert same(getattr(one, field.name), getattr(again, field.name)), field.name
    assert str(again) == str(one)
    assert repr(again) == repr(one)
    assert (again.named, again.candidates, again.estimates.keys()) == (one.named, one.candidates, one.estimates.keys())
    for a, b in zip(one.alarms, again.alarms, strict=True):
        assert again.statement(b) == one.statement(a)
        assert same(one.word(a), again.word(b))
        assert same(one.word(a, 50), again.word(b, 50))
    assert again.to_json() == one.to_json()


@pytest.mark.parametrize("kind", ["default", "bank", "matched", "learnt", "estimator"])
def test_its_page_is_the_same(kind: str, tmp_path: Path) -> None:
    one = found(kind)
    again = rs.Diagnosis.from_json(one.to_json())
    pages = [one_of.to_html(tmp_path / "page.html", title="t").read_text(encoding="utf-8") for one_of in (one, again)]
    assert pages[0] == pages[1]
    assert one._repr_html_() == again._repr_html_()


def test_what_was_found_stands_by_itself() -> None:
    one = found("fitted")
    short = json.loads(one.to_json(whole=False))
    assert len(one.to_json(whole=False)) < 6000
    assert short["whole"] is None
    whole = json.loads(one.to_json())
    assert {k: v for k, v in whole.items() if k not in ("whole", "checksum")} == {
        k: v for k, v in short.items() if k not in ("whole", "checksum")
    }
    assert (short["format"], short["fault_detected"], short["verdict"]) == ("residua-diagnosis", True, "fault")
    assert (short["samples"], short["incomplete"], short["source"]) == (500, 4, "<here>")
    assert [alarm["raised"] for alarm in short["alarms"]] == [alarm.raised for alarm in one.alarms]
    assert short["alarms"][-1]["candidates"][0]["faults"] == list(one.alarms[-1].candidates[0].faults)
    with pytest.raises(FileFormatError, match=r"no series: write it by to_json\(whole=True\)"):
        rs.Diagnosis.from_json(one.to_json(whole=False))


def test_numbers_that_are_not_known_are_null_in_it() -> None:
    one = found("default")
    alarm = replace(one.alarms[0], candidates=(replace(one.candidates[0], score=np.nan, distance=np.nan),))
    short = json.loads(replace(one, alarms=(alarm,)).to_json(whole=False))
    assert short["alarms"][0]["candidates"][0]["score"] is None


def test_a_thinned_diagnosis_comes_back(tmp_path: Path) -> None:
    u, y = rows(500, 1.5)
    path = tmp_path / "rows.csv"
    table = np.hstack([0.5 * np.arange(500)[:, None], u, y])
    np.savetxt(path, table, delimiter=",", header="time,pump,low,high", comments="")
    one = MONITORS["default"]().run_file(path)
    again = rs.Diagnosis.from_json(one.to_json().encode())
    assert (again.recording.thinned, again.totals, str(again)) == (one.recording.thinned, one.totals, str(one))


def changed(change: Callable[[dict[str, Any]], Any]) -> str:
    """Return a text whose content was changed by someone who also wrote a checksum that fits."""
    content = json.loads(found("default").to_json())
    change(content)
    content.pop("checksum", None)
    return dumps(content)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c.update(format="residua-monitor"), "is not a diagnosis of residua"),
        (lambda c: c.update(version=99), "schema version 99, this residua reads version 1"),
        (lambda c: c["whole"].pop("alarms"), "the entry 'whole.alarms' is missing"),
        (lambda c: c["whole"]["parts"].update(code="x = 1"), "whole.parts.code: expected a table"),
        (lambda c: c["whole"].update(more=1), "the entry 'whole.more' is unknown"),
        (lambda c: c["whole"].update(time={"shape": [1], "float": [0.0]}), "must have shape"),
        (lambda c: c["whole"]["statistic"].update(float=["__import__"] * 500), "whole.statistic: expected a number"),
        (lambda c: c["whole"]["test"].update(threshold="4"), "whole.test.threshold: expected a number"),
        (lambda c: c["whole"]["test"].update(threshold=True), "whole.test.threshold: expected a number"),
        (lambda c: c["whole"]["alarms"][0].update(stop=10**6), "must lie within the 500 samples"),
        (lambda c: c["whole"]["alarms"][0].update(start=-5), "must lie within the 500 samples"),
        (lambda c: c["whole"].update(statements=[]), r"whole.statements must be \d, one for each alarm"),
        (lambda c: c["whole"].update(settings={"a": 1}), "whole.settings.a: expected text"),
        (lambda c: c["whole"].update(settings=[]), "whole.settings: expected a table"),
        (lambda c: c["whole"]["recording"].update(compared=[[0, 9]]), "whole.recording.compared"),
        (lambda c: c["whole"]["recording"].update(compared=[[0]]), "whole.recording.compared"),
        (lambda c: c["whole"]["generator"].pop("system"), "'whole.generator.system' is missing"),
        (lambda c: c["whole"]["explainer"].update(colour=[1.0, "nan"]), "whole.explainer.colour"),
        (lambda c: c.update(whole=[]), "whole: expected a table"),
    ],
)
def test_what_is_no_diagnosis_is_refused(change: Callable[[dict[str, Any]], Any], words: str) -> None:
    with pytest.raises(FileFormatError, match=words):
        rs.Diagnosis.from_json(changed(change))


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "1", '{"format": "residua-diagnosis"}', b"\xff\xfe", "\ud800"])
def test_text_that_is_something_else_is_refused(text: str | bytes) -> None:
    with pytest.raises(FileFormatError):
        rs.Diagnosis.from_json(text)


def test_damage_is_refused_wherever_it_is() -> None:
    """Every cut, and single characters that are others."""
    text, rng = found("default").to_json(), np.random.default_rng(0)
    for at in rng.integers(0, len(text) - 2, 60).tolist():
        with pytest.raises(FileFormatError):
            rs.Diagnosis.from_json(text[:at])
        other = "7" if text[at] != "7" else "3"
        damaged = text[:at] + other + text[at + 1 :]
        try:
            same = json.loads(damaged) == json.loads(text)  # the 17th digit of a number may be another
        except ValueError:
            same = False
        if text[at] not in " \n" and not same:
            with pytest.raises(FileFormatError):
                rs.Diagnosis.from_json(damaged)


def test_an_edited_text_says_so() -> None:
    content = json.loads(found("default").to_json())
    content["whole"]["recording"]["source"], content["checksum"] = "elsewhere", None
    made = rs.Diagnosis.from_json(json.dumps(content))
    assert made.recording.source == "elsewhere"
    assert made.notes[0] == EDITED


def test_it_has_statements_about_its_own_alarms_alone() -> None:
    made = rs.Diagnosis.from_json(found("default").to_json())
    assert isinstance(made.isolation, Told)
    with pytest.raises(DataError, match="about its own alarms alone"):
        made.statement(replace(made.alarms[0], start=made.alarms[0].start + 1))


def test_a_plant_with_units_and_an_odd_name_comes_back() -> None:
    odd = sampled_plant(0)
    made = rs.Monitor(rs.design.kalman_filter(odd)).run(np.zeros((60, len(odd.inputs))), np.zeros((60, 4)))
    assert isinstance(made, rs.Diagnosis)
    assert str(rs.Diagnosis.from_json(made.to_json())) == str(made)
