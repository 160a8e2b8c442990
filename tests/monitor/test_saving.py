"""Saved monitors: everything comes back, the linear algebra of the other machine does not matter, damage is refused."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import residua as rs
from residua.decide import NormThreshold
from residua.errors import FileFormatError
from residua.library import three_tank


def continuous() -> rs.Plant:
    return three_tank(dt=0)


def recording(steps: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    found = rs.library.simulate_three_tank(steps, seed=seed)
    return found.u, found.y


def sampled_monitor() -> rs.Monitor:
    monitor = rs.Monitor(rs.design.detection_filter(continuous().without_faults(["leak 3", "clog 32"])), dt=1.0)
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
    names = ("design", "test", "isolate", "settle", "max_hold", "notes", "_generator", "_norm_test", "_spec", "_state")
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
