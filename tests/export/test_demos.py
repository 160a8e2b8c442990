"""The monitors of the demos and of the examples of pages, in every target."""

from __future__ import annotations

import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import residua as rs
from compiled_exports import CompiledExport
from effort import cases
from export_banks import bank_expected
from export_examples import expected
from residua.demos import jet_engine
from residua.export.monitor_program import monitor_program
from residua.export.structured_text import function_block
from residua.monitor.running import initial_state, run_reference
from running_fmus import RunningFMU
from running_models import RunningModel
from structured_text import FunctionBlock

DEMOS = ("three tanks", "jet engine, robust", "jet engine", "sensor bank")


@cache
def demo(name: str) -> tuple[rs.Monitor, np.ndarray]:
    """Return a monitor of a demo, and a recording with a fault."""
    if name == "three tanks":
        plant = rs.library.three_tank()
        monitor = rs.Monitor(rs.design.kalman_filter(plant))
        normal, leak = (
            rs.library.simulate_three_tank(600, seed=k, faults=f) for k, f in ((1, None), (3, {"leak 3": 1.0}))
        )
        return monitor.fit(normal.u, normal.y, time=normal.time), np.hstack([leak.u, leak.y])
    recording = jet_engine.record(jet_engine.library_engine().faults[1])
    data = np.hstack([recording.u, recording.y])
    engine = jet_engine.library_engine().without_faults("fuel actuator")
    if name == "sensor bank":
        generator = rs.design.sensor_fault_bank(engine)
        return rs.Monitor(
            generator, test=rs.decide.NormThreshold(threshold=2e-5, whiten="none"), dt=jet_engine.STEP
        ), data
    make = rs.design.robust_detection_filter if name.endswith("robust") else rs.design.detection_filter
    more = {"H0": np.zeros((3, 6))} if name.endswith("robust") else {}
    generator = make(engine, poles=jet_engine.POLES, **more)
    threshold = 0.5 * min(jet_engine.expected_effect(generator, fault) for fault in engine.faults)
    test = rs.decide.NormThreshold(threshold=threshold, whiten="none")
    return rs.Monitor(generator, test=test, isolate=rs.decide.Directional(), dt=jet_engine.STEP), data


@pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc")
@pytest.mark.parametrize("name", cases(DEMOS, 2))
def test_every_target_has_the_answers_of_a_demo(name: str, tmp_path: Path) -> None:
    for package in ("fmpy", "onnx", "onnxruntime"):
        pytest.importorskip(package, reason=f"there is no {package}")
    monitor, data = demo(name)
    made = monitor_program(monitor, missing="hold")
    spec, n_u = replace(made.specification), len(made.inputs)
    _, decisions = run_reference(spec, initial_state(spec, 1), data[None])
    right = (expected if made.judging.parts is None else bank_expected)(spec, decisions)
    assert right[:, len(made.residuals) + 3].any()  # an alarm
    for flag in ("-O0", "-O3"):
        (folder := tmp_path / flag).mkdir()
        assert np.array_equal(CompiledExport(made, folder, flag).run(data[:, :n_u], data[:, n_u:]), right)
    more: dict[str, Any] = {"missing": "hold", "binary": True}
    for version in ("2.0", "3.0"):
        fmu = RunningFMU(rs.export.to_fmu(monitor, tmp_path / version / "w.fmu", version=version, **more).path)
        assert np.array_equal(fmu.run(data), right)
        fmu.close()
    model = rs.export.to_onnx(monitor, tmp_path / "w.onnx", missing="hold")
    got, residuals = RunningModel(model.path).run(data), len(made.residuals)
    assert np.array_equal(got[:, residuals + 1 : residuals + 4], right[:, residuals + 1 : residuals + 4])
    assert model.bound is not None
    larger = np.max(np.abs(data - spec.offset).max(axis=0) / model.within, initial=1.0)  # than what the bound is for
    decided = right[:, residuals + 2] > 0
    assert (np.abs(got - right)[decided, :residuals] <= larger * model.bound).all()
    block = FunctionBlock(function_block(made, "watch"))
    for one, row in zip(data[:120], right, strict=False):
        out = block.step(one[:n_u], one[n_u:])
        assert np.array_equal([*out["residual"], out["statistic"]], row[: residuals + 1])
