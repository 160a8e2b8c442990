"""Saved monitors: everything comes back, the linear algebra of the other machine does not matter, damage is refused."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

import residua as rs
from effort import cases, rounds
from residua.decide import NormThreshold
from residua.decide.matched_recursion import HeldState
from residua.errors import AccuracyError, FileFormatError, SettingError
from residua.library import three_tank
from residua.linear import RankDecision
from residua.monitor.design_records import generator_in, generator_out
from residua.report.tables import evidence_html


def continuous() -> rs.Plant:
    return three_tank(dt=0)


@cache
def recording(steps: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    found = rs.library.simulate_three_tank(steps, seed=seed)
    for shared in (found.u, found.y):
        shared.flags.writeable = False
    return found.u, found.y


def sampled_monitor() -> rs.Monitor:
    design = rs.design.detection_filter(continuous().without_faults(["leak 3", "clog 32"]))
    monitor = rs.Monitor(design, test=NormThreshold(), dt=1.0)
    return monitor.fit(*recording(3000, 1))


def sampled_bank() -> rs.Monitor:
    bank = rs.design.sensor_fault_bank(continuous())
    return rs.Monitor(bank, test=NormThreshold(window=5), dt=1.0).fit(*recording(3000, 1))


def assert_same(one: Any, other: Any, where: str = "") -> None:
    """Compare whatever hangs below two objects, floats by their bits."""
    assert type(one) is type(other), where
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype, where
        assert one.shape == other.shape, where
        assert one.tobytes() == other.tobytes(), where
    elif hasattr(one, "__dataclass_fields__"):
        for field in fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name), f"{where}.{field.name}")
    elif isinstance(one, dict):
        assert list(one) == list(other), where
        for key in one:
            assert_same(one[key], other[key], f"{where}.{key}")
    elif isinstance(one, (tuple, list)):
        assert len(one) == len(other), where
        for k, (a, b) in enumerate(zip(one, other, strict=True)):
            assert_same(a, b, f"{where}[{k}]")
    else:
        assert one == other or (one != one and other != other), where


def monitors() -> dict[str, Callable[[], rs.Monitor]]:
    plant = three_tank()
    engine = rs.library.jet_engine()
    return {
        "fitted Kalman filter": lambda: rs.Monitor(rs.design.kalman_filter(plant)).fit(*recording(3000, 1)),
        "sampled detection filter": sampled_monitor,
        "sampled bank, fitted": sampled_bank,
        "bank, step not known": lambda: rs.Monitor(rs.design.sensor_fault_bank(continuous())),
        "bank without isolation": lambda: rs.Monitor(rs.design.sensor_fault_bank(plant), isolate=None),
        "decoupled filter, step not known": lambda: rs.Monitor(rs.design.robust_detection_filter(engine)),
        "observer": lambda: rs.Monitor(
            rs.design.unknown_input_observer(engine).residual_generator(), dt=0.01, settle=7, isolate=None
        ),
        "threshold given": lambda: rs.Monitor(
            rs.design.kalman_filter(plant), test=NormThreshold(threshold=3.0, window=4, whiten="none"), max_hold=3
        ),
    }


@pytest.mark.parametrize("kind", monitors())
def test_everything_comes_back(kind: str, tmp_path: Path) -> None:
    monitor = monitors()[kind]()
    monitor.notes = ("said by hand",)
    if monitor.is_fitted and len(monitor.generator.plant.inputs) == 2:
        monitor.update(*recording(100, 2))
    monitor.save(tmp_path / "m.json")
    loaded = rs.Monitor.load(tmp_path / "m.json")
    names = ("design", "test", "isolate", "settle", "max_hold", "notes", "_generator", "_test", "_spec", "_state")
    for name in names:
        assert_same(getattr(monitor, name), getattr(loaded, name), name)
    loaded.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_text() == (tmp_path / "m.json").read_text()


@pytest.mark.parametrize("make", [sampled_monitor, sampled_bank])
def test_a_loaded_monitor_does_not_depend_on_the_linear_algebra_here(
    make: Callable[[], rs.Monitor], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monitor = make()
    u, y = recording(400, 3)
    monitor.update(u[:200], y[:200])
    monitor.save(tmp_path / "m.json")
    expected = monitor.update(u[200:], y[200:])

    def elsewhere(function: Callable) -> Callable:
        return lambda *args, **kwargs: function(*args, **kwargs) * (1 + 4e-16)

    for name in ("solve", "inv", "pinv"):
        monkeypatch.setattr(np.linalg, name, elsewhere(getattr(np.linalg, name)))
    svd = np.linalg.svd

    def other_svd(*args: Any, **kwargs: Any) -> Any:
        found = svd(*args, **kwargs)
        return tuple(part * (1 + 4e-16) for part in found) if isinstance(found, tuple) else found

    monkeypatch.setattr(np.linalg, "svd", other_svd)
    assert_same(expected, rs.Monitor.load(tmp_path / "m.json").update(u[200:], y[200:]))


def walk(value: Any, path: tuple = ()) -> Any:
    """Yield the place of every entry of a table."""
    if isinstance(value, dict):
        for key, entry in value.items():
            yield (*path, key)
            yield from walk(entry, (*path, key))


FREE = {"subspaces", "units", "decoupling", "conditions", "ranks"}  # tables by name


@pytest.mark.parametrize("make", [sampled_monitor, sampled_bank])
def test_every_missing_and_unknown_entry_is_named(make: Callable[[], rs.Monitor], tmp_path: Path) -> None:
    path = tmp_path / "m.json"
    monitor = make()
    monitor.update(*recording(50, 2))
    monitor.save(path)
    text = path.read_text()
    tables = [place for place in walk(json.loads(text)) if not FREE & set(place[:-1]) and place != ("format",)]
    for place in tables[:: max(1, len(tables) // 60)]:
        content = json.loads(text)
        table = content
        for key in place[:-1]:
            table = table[key]
        value = table.pop(place[-1])
        path.write_text(json.dumps(content))
        with pytest.raises(FileFormatError, match=r"^m\.json"):
            rs.Monitor.load(path)
        table |= {place[-1]: value, "colour": "red"}
        path.write_text(json.dumps(content))
        with pytest.raises(FileFormatError, match=r"colour|array must be"):
            rs.Monitor.load(path)


BAD = {
    "nested": ('"notes": []', '"notes": ' + "[" * 100_000, "not JSON"),
    "NaN": ('"max_hold": 10', '"max_hold": NaN', "NaN"),
    "infinity": ('"max_hold": 10', '"max_hold": -Infinity', "Infinity"),
    "huge number": ('"max_hold": 10', '"max_hold": 1' + "0" * 5000, "not JSON"),
    "huge whole number": ('"max_hold": 10', '"max_hold": 1' + "0" * 40, "max_hold"),
    "fraction": ('"max_hold": 10', '"max_hold": 1.5', "max_hold"),
    "text": ('"max_hold": 10', '"max_hold": "ten"', "max_hold"),
    "notes that are no texts": ('"notes": []', '"notes": [1]', "notes.0: expected text"),
}


@pytest.mark.parametrize("case", BAD)
def test_damaged_text_is_refused(case: str, tmp_path: Path) -> None:
    path = tmp_path / "m.json"
    rs.Monitor(rs.design.kalman_filter(three_tank())).save(path)
    old, new, words = BAD[case]
    text = path.read_text()
    head, tail = text[: text.rindex(old)], text[text.rindex(old) + len(old) :]
    path.write_text(head + new + tail)
    with pytest.raises(FileFormatError, match=words):
        rs.Monitor.load(path)


SHAPES = {
    "huge": [10**30],
    "empty and huge": [0, 10**30],
    "negative": [-3, -3],
    "fraction": [3.0, 3],
    "many": [1] * 60,
    "text": "3 x 3",
    "other": [9],
}


@pytest.mark.parametrize("case", SHAPES)
def test_odd_shapes_are_refused(case: str, tmp_path: Path) -> None:
    path = tmp_path / "m.json"
    rs.Monitor(rs.design.kalman_filter(three_tank())).save(path)
    content = json.loads(path.read_text())
    content["design"]["system"]["A"]["shape"] = SHAPES[case]
    path.write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match=r"m\.json: "):
        rs.Monitor.load(path)


@pytest.mark.parametrize("number", [1e999, math.nan, "high", None, True, [1.0]])
def test_odd_numbers_are_refused(number: object, tmp_path: Path) -> None:
    path = tmp_path / "m.json"
    rs.Monitor(rs.design.kalman_filter(three_tank())).save(path)
    content = json.loads(path.read_text())
    content["design"]["system"]["A"]["float"][0] = number
    path.write_text(json.dumps(content))
    with pytest.raises(FileFormatError):
        rs.Monitor.load(path)
    path.write_text(json.dumps(content).replace("Infinity", "1e999"))
    with pytest.raises(FileFormatError):
        rs.Monitor.load(path)


# ------------------------------------------------------- what a number may be, and the checksum


def fitted(start: str = "estimated") -> rs.Monitor:
    design = rs.design.kalman_filter(three_tank())
    monitor = rs.Monitor(design, test=NormThreshold(), start=start).fit(*recording(3000, 1))
    monitor.update(*recording(50, 2))
    return monitor


def fitted_bank() -> rs.Monitor:
    monitor = sampled_bank()
    monitor.update(*recording(50, 2))
    return monitor


@cache
def saved(make: Callable[[], rs.Monitor]) -> str:
    """Return the file of a monitor."""
    with TemporaryDirectory() as folder:
        make().save(path := Path(folder) / "m.json")
        return path.read_text()


def numbers(value: Any, path: tuple = ()) -> Any:
    """Yield the place of one number of every list of numbers, and of every number that stands alone."""
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from numbers(entry, (*path, key))
    elif isinstance(value, list):
        plain = [k for k, entry in enumerate(value) if isinstance(entry, (int, float))]
        if plain and "shape" not in path:
            yield (*path, plain[len(plain) // 2])
        for k, entry in enumerate(value):
            if isinstance(entry, (list, dict)):
                yield from numbers(entry, (*path, k))
    elif isinstance(value, (int, float)):
        yield path


def changed(content: Any, place: tuple, value: object) -> Any:
    """Return a content with one entry replaced."""
    copy = json.loads(json.dumps(content))
    table = copy
    for key in place[:-1]:
        table = table[key]
    table[place[-1]] = value
    return copy


#: Entries of what a design reports about itself, which may be infinite or not known; nothing of it runs.
REPORTS = {"decoupling", "conditions", "visible"}


@pytest.mark.parametrize("make", [fitted, fitted_bank])
@pytest.mark.parametrize("turn", cases(range(3), 1))
def test_no_number_that_runs_may_be_missing_or_infinite(
    make: Callable[[], rs.Monitor], turn: int, tmp_path: Path
) -> None:
    """Each place gets one of the three, and in the campaign the others too."""
    values = ("nan", "inf", "-inf")
    path = tmp_path / "m.json"
    content = json.loads(saved(make))
    assert content["checksum"]
    content["checksum"] = None
    places = [place for place in numbers(content) if not {*REPORTS, "match_held", "version"} & {*place}]
    assert {place[0] for place in places} >= {"design", "test", "fitted", "running", "state"}
    assert ("running", "start") in {place[:2] for place in places}
    assert {("state", "filter", "x"), ("state", "filter", "held")} <= {place[:3] for place in places}
    runs = [place for place in places if place[0] in ("fitted", "running", "state")]
    rest = [place for place in places if place not in runs]
    for k, place in enumerate([*runs, *rest[:: max(1, len(rest) // 40)]]):
        path.write_text(json.dumps(changed(content, place, values[(k + turn) % 3])))
        with pytest.raises(FileFormatError, match=r": expected .*, got |must be that of "):
            rs.Monitor.load(path)


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (("running", "start", "float", 0), "nan", r"running\.start.*expected a finite number"),
        (("running", "start", "float", 0), 7.0, r"running\.start must be the state that the filter settles to"),
        (("state", "filter", "x", "float", 0), "inf", r"state\.filter\.x.*: expected a finite number"),
        (("state", "filter", "held", "float", 1), "-inf", r"state\.filter\.held.*: expected a finite number"),
        (
            ("state", "filter", "age", "int", 0),
            -1,
            r"state\.filter\.age\[0\]: expected a whole number, 0 or more, got -1",
        ),
        (
            ("state", "test", "window", "filled", "int", 0),
            10**6,
            r"state\.test\.window\.filled must be below the window",
        ),
        (("fitted", "threshold"), "inf", r"fitted\.threshold: expected a positive, finite number"),
        (("fitted", "threshold"), 0, r"fitted\.threshold: expected a positive, finite number, got 0"),
        (("fitted", "persistence"), 0, r"fitted\.persistence: expected a whole number, 1 or more, got 0"),
        (("test", "window"), 10**9, r"test\.window: expected a whole number from 1 to"),
        (("fitted", "whitening", "float", 0), 1e308, r"fitted\.whitening\[0, 0\]: expected a finite number of at most"),
        (("test", "false_alarm_rate"), 1.5, r"test\.false_alarm_rate: expected a number between 0 and 1, got 1.5"),
        (("design", "system", "A", "float", 0), 1e308, r"design\.system\.A\[0, 0\]: expected a finite number of at"),
        (("design", "system", "dt"), -1.0, r"design\.system\.dt: expected 0, or a positive number"),
        (("running", "isolation", "bases", 0, "float", 0), 3.0, r"running\.isolation\.bases\[0\]: .* orthonormal"),
    ],
)
def test_the_message_names_the_entry_and_what_it_may_be(
    place: tuple, value: object, words: str, tmp_path: Path
) -> None:
    path = tmp_path / "m.json"
    fitted().save(path)
    path.write_text(json.dumps(changed(json.loads(path.read_text()), place, value)))
    with pytest.raises(FileFormatError, match=rf"^m\.json: {words}"):
        rs.Monitor.load(path)


def test_whitening_that_leaves_a_residual_out_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.json"
    fitted().save(path)
    content = json.loads(path.read_text())
    k = content["fitted"]["whitening"]["shape"][0]
    content["fitted"]["whitening"]["float"][:k] = [0.0] * k
    path.write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match="whitening must be invertible"):
        rs.Monitor.load(path)


def test_whitening_that_overflows_is_refused(tmp_path: Path) -> None:
    """It would judge no sample, without a word."""
    path = tmp_path / "m.json"
    fitted().save(path)
    content = json.loads(path.read_text())
    content["fitted"]["whitening"]["float"][0] = 1e100
    path.write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match="no residual is known so well"):
        rs.Monitor.load(path)


@pytest.mark.parametrize(
    ("place", "value"),
    [(0, 99.0), (0, 0.5), (1, 1e300), (2, -1.0), (2, float("nan")), (3, 0.5), (4, 1e9), (5, -1.0), (5, float("nan"))],
)
def test_a_standing_alarm_that_cannot_be_is_refused(place: int, value: float) -> None:
    """Fault, arrival, sample that they come from, whether they are final, raising, likelihood."""
    row = np.array([[0.0, 15.0, 19.0, 1.0, 16.0, 556.6]])
    on = np.array([True])
    HeldState(row, on).check("held", faults=2, window=40, count=30)
    row[0, place] = value
    with pytest.raises(FileFormatError, match="no alarm within 30 samples"):
        HeldState(row, on).check("held", faults=2, window=40, count=30)
    HeldState.empty(3).check("held", faults=2, window=40, count=0)


def test_a_number_that_changed_without_a_word_is_refused(tmp_path: Path) -> None:
    """A threshold of ten times its size is a threshold like any other, and blind."""
    path = tmp_path / "m.json"
    monitor = fitted()
    monitor.save(path)
    content = json.loads(path.read_text())
    content["fitted"]["threshold"] *= 10
    path.write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match="its content is not what was saved"):
        rs.Monitor.load(path)
    del content["checksum"]
    path.write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match="'checksum' is missing"):
        rs.Monitor.load(path)


def test_an_edited_file_is_taken_when_it_says_so_and_every_diagnosis_repeats_it(tmp_path: Path) -> None:
    path = tmp_path / "m.json"
    fitted().save(path)
    content = json.loads(path.read_text())
    content["fitted"]["threshold"] *= 10
    content["checksum"] = None
    path.write_text(json.dumps(content, indent=2))
    loaded = rs.Monitor.load(path)
    assert loaded.threshold == content["fitted"]["threshold"]
    assert any("was edited" in note for note in loaded.notes)
    found = loaded.run(*recording(300, 4))
    assert isinstance(found, rs.Diagnosis)
    assert any("was edited" in note for note in found.notes)
    loaded.save(path)
    assert rs.Monitor.load(path).notes == loaded.notes


def test_how_a_file_is_laid_out_does_not_count(tmp_path: Path) -> None:
    path = tmp_path / "m.json"
    fitted().save(path)
    path.write_text(json.dumps(json.loads(path.read_text()), indent=1))
    assert rs.Monitor.load(path).notes == ()


def test_an_entry_that_is_there_twice_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.json"
    fitted().save(path)
    path.write_text(path.read_text().replace('"max_hold": 10', '"max_hold": 10, "max_hold": 10'))
    with pytest.raises(FileFormatError, match="'max_hold' occurs twice"):
        rs.Monitor.load(path)


@pytest.mark.parametrize("window", [5, 10**6])
def test_windows_that_do_not_belong_together_are_refused_before_anything_is_made_of_them(
    window: int, tmp_path: Path
) -> None:
    """A window of a million samples, in a file that has the responses of five, took a quarter of an hour to refuse."""
    path = tmp_path / "m.json"
    rs.Monitor(rs.design.matched_filters(three_tank(), window=4)).save(path)
    whole = json.loads(path.read_text())
    cases = {
        (("isolate", "window"),): r"fitted\.matched\.window must be that of isolate",
        (("isolate", "window"), ("fitted", "matched", "window")): r"fitted\.matched\.responses must be those of",
        (("test", "window"),): r"fitted\.window must be that of the test",
        (("running",),): r"running must be present if and only if fitted is",
    }
    for places, words in cases.items():
        content = whole
        for place in places:
            content = changed(content, place, None if place == ("running",) else window)
        path.write_text(json.dumps(content))
        with pytest.raises(FileFormatError, match=words):
            rs.Monitor.load(path)


def test_a_design_that_leaks_is_not_loaded() -> None:
    """The leak is measured again: neither the checksum nor the evidence of a file can promise it."""
    good = rs.design.unknown_input_observer(rs.library.jet_engine()).residual_generator()
    for made in (good, good.discretize(0.01)):
        generator_in(generator_out(made), "design")
        wrong = replace(made, system=made.system.replaced(B=1.1 * made.system.B))
        with pytest.raises(FileFormatError, match="design: the control inputs reach the residual"):
            generator_in(generator_out(wrong), "design")
        wrong = replace(made, plant=made.plant.without_disturbances().with_disturbances({"gust": [0, 0, 1]}))
        with pytest.raises(FileFormatError, match="design: the disturbance inputs reach the residual"):
            generator_in(generator_out(wrong), "design")


def integrating(seed: int) -> rs.Plant:
    """Return a sampled chain of states, of which most integrate."""
    rng = np.random.default_rng([12, seed])
    n, p = int(rng.integers(2, 7)), int(rng.integers(1, 4))
    A = np.triu(rng.integers(-3, 4, (n, n)), 1).astype(float)
    A[np.arange(n - 1), np.arange(1, n)] = rng.integers(1, 4, n - 1)
    A -= np.diag(np.where(rng.random(n) < 0.2, rng.integers(1, 3, n), 0))
    C = np.eye(n)[np.r_[0, rng.integers(0, n, p - 1)]]
    plant = rs.Plant(A, np.eye(n)[:, -1:], C).with_sensor_faults().with_actuator_faults()
    return plant.discretize(float(rng.choice([0.02, 0.1, 0.5])))


@pytest.mark.parametrize("count", rounds(36, 200))
def test_designs_of_sampled_plants_that_integrate_come_back(count: int) -> None:
    """Below the frequencies of its evidence what rounding leaves of a filter grows without end, as the plant does."""
    for seed in range(count):
        plant = integrating(seed)
        for design in (rs.design.decoupled_residual, rs.design.parity_relations):
            try:
                made = design(plant)
            except AccuracyError:
                continue
            assert generator_in(generator_out(made), "design").n_residuals == made.n_residuals, (seed, design.__name__)


def test_a_rank_is_saved_and_shown_and_counts_no_more_than_its_singular_values() -> None:
    decision = RankDecision(2, np.array([3.0, 1e-2, 1e-16]), 3e-13)
    assert str(decision) == "rank 2 (smallest kept 0.01, largest dropped 1e-16)"
    made = sampled_monitor().generator
    evidence = made.evidence.extended(ranks={"states": decision})
    record = generator_out(replace(made, evidence=evidence))
    back = generator_in(json.loads(json.dumps(record)), "design")
    assert_same(back.evidence.ranks, {"states": decision})
    assert "3, 0.01" in evidence_html(back.evidence)
    record["evidence"]["ranks"]["states"]["rank"] = 4
    with pytest.raises(FileFormatError, match="a rank of 4 does not fit 3 singular values"):
        generator_in(json.loads(json.dumps(record)), "design")


@pytest.mark.parametrize("share", [0.3, 0.9])
def test_a_file_that_was_cut_short_is_called_so(share: float, tmp_path: Path) -> None:
    path = tmp_path / "m.json"
    rs.Monitor(rs.identify.given_residuals(1)).fit(None, np.random.default_rng(0).standard_normal((500, 1))).save(path)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(FileFormatError, match="it is cut short"):
        rs.Monitor.load(path)


def test_a_rate_and_a_frame_that_are_none_are_errors_of_the_package() -> None:
    data = np.random.default_rng(0).standard_normal((500, 1))
    monitor = rs.Monitor(rs.identify.given_residuals(1))
    with pytest.raises(SettingError, match="false_alarm_rate must lie between 0 and 1"):
        monitor.fit(None, data, false_alarm_rate="1%")  # pyright: ignore[reportArgumentType]
    with pytest.raises(SettingError, match="backend must be"):
        monitor.fit(None, data).run(None, data).to_frame("zzz")
