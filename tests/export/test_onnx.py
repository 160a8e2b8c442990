"""ONNX models: valid, within their bound in ONNX Runtime, however a recording is cut."""

from __future__ import annotations

import contextlib
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import residua as rs
from effort import cases
from export_examples import expected, exported
from fused_examples import ISOLATIONS, MARKS, ORDERS, TESTS, recording, specification
from guards import trips
from residua.errors import AccuracyError, DataError, MissingExtraError, NotFittedError, SettingError
from residua.export import onnx as written
from residua.export.monitor_program import DOUBLE, FLOAT
from residua.export.onnx import pack
from residua.export.selftest import comparison
from residua.monitor.running import initial_state, run_reference
from running_models import RunningModel

onnx = pytest.importorskip("onnx", reason="there is no onnx")
pytest.importorskip("onnxruntime", reason="there is no ONNX Runtime")


def specified(seed: int) -> tuple[Any, np.random.Generator]:
    rng = np.random.default_rng(seed)
    order = int(rng.choice([*ORDERS, 40]))
    test = list(TESTS)[seed % len(TESTS) if order or seed % len(TESTS) != len(TESTS) - 1 else 0]
    isolation, method = str(rng.choice(list(ISOLATIONS))), ("kalman", "observer")[seed // len(TESTS) % 2]
    return replace(specification(test, isolation, order, int(rng.choice([1, 2, 3, 5])), method), partial=None), rng


@pytest.mark.parametrize("seed", cases(range(200), 4))
def test_double_precision_is_the_monitor_but_for_rounding(seed: int, tmp_path: Path) -> None:
    """Of generated monitors of every kind, with missing values, infinities and overflows."""
    spec, rng = specified(seed)
    made = pack(exported(spec, int(rng.integers(spec.B.shape[1])), DOUBLE), tmp_path / "one.onnx", "one")
    onnx.checker.check_model(onnx.load(made.path), full_check=True)
    model, residuals = RunningModel(made.path), len(spec.C)
    for data in recording(spec, rng, 300, [*MARKS]):
        with np.errstate(all="ignore"):
            _, decisions = run_reference(spec, initial_state(spec, 1), data[None])
        right, got = expected(spec, decisions), model.run(data)
        model.reset()
        assert np.array_equal(got[:, residuals + 1 : residuals + 4], right[:, residuals + 1 : residuals + 4])
        decided = right[:, residuals + 2] > 0
        huge = (np.abs(np.where(np.isfinite(data), data, 0.0)) > 1e6).any(axis=1)
        fine = decided & ~(np.cumsum(huge) > 0)  # before what is far outside of the sizes of the bound
        scale = np.maximum(1.0, np.abs(data[fine] - spec.offset).max(axis=0, initial=0.0) / made.within).max(
            initial=1.0
        )
        if made.bound is not None:
            assert (np.abs(got - right)[fine][:, :residuals] <= made.bound * scale).all()
        assert np.allclose(got[fine], right[fine], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", cases(range(200), 2))
def test_single_precision_stays_within_its_bound(seed: int, tmp_path: Path) -> None:
    spec, _ = specified(seed)
    made = exported(spec, 1 if spec.B.shape[1] > 1 else 0, FLOAT)
    with contextlib.suppress(SettingError):  # where nothing can be promised, nothing is written
        model = pack(made, tmp_path / "one.onnx", "one")
    if not (tmp_path / "one.onnx").exists():
        with pytest.raises(SettingError, match="export it in double precision"):
            pack(made, tmp_path / "one.onnx", "one")
        return
    one = comparison(made)
    got = RunningModel(model.path).run(np.hstack([one.u, one.y]))
    assert np.array_equal(got[:, len(spec.C) + 1], one.known)
    assert model.bound is not None
    assert (np.abs(got[:, : len(spec.C)] - one.residuals)[one.decided] <= model.bound).all()


def tank() -> rs.Plant:
    plant = rs.Plant(
        [[0.9, 0.05], [0.0, 0.8]], [[0.1], [0.2]], np.eye(2), dt=1, inputs=["valve"], outputs=["level", "flow"],
        units={"level": "cm"}, name="Tank 7 (east)",
    )  # fmt: skip
    plant = plant.with_operating_point(inputs=[2.0], outputs=[30.0, 4.0]).with_sensor_faults()
    return plant.with_noise(process=1e-4 * np.eye(2), measurement=1e-2 * np.eye(2))


def watch(plant: rs.Plant | None = None, **more: Any) -> rs.Monitor:
    return rs.Monitor(rs.design.kalman_filter(tank() if plant is None else plant), **more)


def samples(count: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    data = np.hstack([2.0 + rng.standard_normal((count, 1)), [30.0, 4.0] + 0.3 * rng.standard_normal((count, 2))])
    data[count // 2 :, 1] += 3.0
    return data


@pytest.mark.parametrize("precision", ["double", "float"])
def test_any_cut_gives_the_same_bits(precision: str, tmp_path: Path) -> None:
    monitor = watch(test=rs.decide.CUSUM(mean_time_between_false_alarms=1e4))
    made = rs.export.to_onnx(monitor, tmp_path, precision=precision, missing="hold")
    assert made.path.name == "tank_7_east.onnx"
    data, model = samples(120), RunningModel(made.path)
    data[30:34, 1] = np.nan
    whole = model.run(data)
    for cuts in ([1], [119], [40, 41, 90], list(range(1, 120))):
        model.reset()
        parts = np.vstack([model.run(part) for part in np.split(data, cuts)])
        assert np.array_equal(parts, whole)
    assert whole[-1, 5]  # an alarm


def test_samples_that_are_missing_or_infinite(tmp_path: Path) -> None:
    monitor = watch()
    spec = replace(monitor._specification(), partial=None)
    model = RunningModel(rs.export.to_onnx(monitor, tmp_path, missing="hold").path)
    for value in (np.nan, np.inf, -np.inf):
        data = np.vstack([samples(30), np.full((40, 3), value), samples(30)])
        model.reset()
        _, decisions = run_reference(spec, initial_state(spec, 1), data[None])
        assert np.allclose(model.run(data), expected(spec, decisions), rtol=1e-12, atol=1e-12)


def test_it_says_what_it_is_and_has_the_same_bytes_from_a_file(tmp_path: Path) -> None:
    monitor = watch()
    monitor.save(tmp_path / "m.json")
    made = [
        rs.export.to_onnx(one, tmp_path / name, name="w", missing="hold")
        for name, one in (("a", monitor), ("b", rs.Monitor.load(tmp_path / "m.json")))
    ]
    assert made[0].path.read_bytes() == made[1].path.read_bytes()
    about = {one.key: one.value for one in onnx.load(made[0].path).metadata_props}
    assert json.loads(about["inputs"]) == ["valve"]
    assert json.loads(about["outputs"]) == ["level", "flow"]
    assert json.loads(about["units"]) == ["", "cm", ""]
    assert json.loads(about["groups"]) == [["level sensor"], ["flow sensor"]]
    assert made[0].bound is not None
    assert json.loads(about["bound"]) == made[0].bound.tolist()
    assert "its last value is held" in about["notes"]
    assert "without a certificate" in about["notes"]


@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_plant_without_inputs_and_with_odd_names(precision: str, tmp_path: Path) -> None:
    plant = rs.Plant([[0.9]], np.zeros((1, 0)), [[1.0], [2.0]], dt=1, outputs=["T_1 (°C) */", "u"], name="Ofen */ ü")
    plant = plant.with_sensor_faults().with_noise(process=1e-3, measurement=1e-2)
    monitor = rs.Monitor(rs.design.kalman_filter(plant))
    made = rs.export.to_onnx(monitor, tmp_path / "Ofen 3.onnx", precision=precision, missing="hold")
    model = RunningModel(made.path)
    assert set(model.shapes) == {"y", "state", "counts"}
    spec = replace(monitor._specification(), partial=None)
    data = np.random.default_rng(0).standard_normal((60, 2)).astype(np.float32).astype(float)
    _, decisions = run_reference(spec, initial_state(spec, 1), data[None])
    right, got = expected(spec, decisions), model.run(data)
    decided = right[:, 4] > 0
    assert decided.any()
    assert np.allclose(got[decided, :2], right[decided, :2], atol=1e-5 if precision == "float" else 1e-14)


@trips("export.onnx:_check")
def test_a_model_that_answers_otherwise_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(written, "rounding_bound", lambda spec, *_: np.full(len(spec.C), -1.0))
    with pytest.raises(AccuracyError, match="the ONNX model does not answer as the monitor"):
        rs.export.to_onnx(watch(), tmp_path / "none.onnx", missing="hold")
    assert not (tmp_path / "none.onnx").exists()


def test_without_the_extra_it_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(MissingExtraError, match=r"residua\[onnx\]"):
        rs.export.to_onnx(watch(), tmp_path / "none.onnx", missing="hold")
    assert list(tmp_path.iterdir()) == []


def test_what_it_cannot_hold_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    target = tmp_path / "none.onnx"
    with pytest.raises(SettingError, match="cannot be exported"):
        rs.export.to_onnx(watch(test=rs.decide.SPRT()), target, missing="hold")
    with pytest.raises(SettingError, match="goes on through missing outputs"):
        rs.export.to_onnx(watch(), target)
    with pytest.raises(SettingError, match="precision must be 'double' or 'float', got 'half'"):
        rs.export.to_onnx(watch(), target, missing="hold", precision="half")
    with pytest.raises(SettingError, match="'monitor_2_tanks' would do"):
        rs.export.to_onnx(watch(), target, missing="hold", name="2 tanks")
    plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1).with_sensor_faults()
    with pytest.raises(NotFittedError):
        rs.export.to_onnx(rs.Monitor(rs.design.unknown_input_observer(plant).residual_generator()), target)
    assert list(tmp_path.iterdir()) == []
    rs.export.to_onnx(watch(), target, missing="hold")
    with pytest.raises(DataError, match=r"none\.onnx is there already"):
        rs.export.to_onnx(watch(), target, missing="hold")
    rs.export.to_onnx(watch(), target, missing="hold", overwrite=True)
