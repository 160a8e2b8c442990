"""Banks and groups of residuals as exports: tests of members, the code, and what is read from it."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import residua as rs
from compiled_exports import STRICT, CompiledExport
from effort import cases
from export_banks import ANSWERS, KINDS, bank_expected, bank_monitor, recorded
from residua.decide import Structured
from residua.decide.structured import code_test
from residua.export.monitor_program import DOUBLE, MonitorProgram, monitor_program, specification_program
from residua.export.structured_text import function_block
from residua.monitor.fused import run_block
from residua.monitor.running import initial_state
from running_fmus import RunningFMU
from running_models import RunningModel
from structured_text import FunctionBlock

needs_compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc")
SEEDS = cases(range(210), 7)


def example(seed: int) -> rs.Monitor:
    return bank_monitor(KINDS[seed % len(KINDS)], 2 + seed % 4, (1, 5)[seed // 7 % 2], seed)


def wanted(monitor: rs.Monitor, data: np.ndarray) -> np.ndarray:
    spec = replace(monitor._specification(), partial=None)
    _, decisions = run_block(spec, initial_state(spec, 1), data[None])
    return bank_expected(spec, decisions)


@needs_compiler
@pytest.mark.parametrize("seed", SEEDS)
def test_c_has_the_bits_of_the_monitor(seed: int, tmp_path: Path) -> None:
    monitor = example(seed)
    made = monitor_program(monitor, missing="hold")
    data, n_u = recorded(monitor, seed, 3000), len(made.inputs)
    right = wanted(monitor, data)
    for flag in ("-O0", "-O3"):
        (folder := tmp_path / flag).mkdir()
        assert np.array_equal(CompiledExport(made, folder, flag).run(data[:, :n_u], data[:, n_u:]), right)
    assert right[:, len(made.residuals) + 3].any()  # alarms


def with_codes(monitor: rs.Monitor, rng: np.random.Generator) -> MonitorProgram:
    """Return the program of a bank whose members mean other faults: codes of any kind, some once constant."""
    made = monitor_program(monitor, missing="hold")
    members, faults = len(made.parts), int(rng.integers(1, 7))
    table = rng.random((members, faults)) < rng.choice([0.3, 0.5, 0.8])
    table[0, 0] |= not table.any()  # a bank no fault of which fires anything has no codes
    if rng.random() < 0.4:  # as many ones in each: strongly isolating
        ones = int(rng.integers(1, members))
        table = np.array([np.isin(np.arange(members), rng.permutation(members)[:ones]) for _ in range(faults)]).T
    settled = table & (rng.random(table.shape) < 0.7) if rng.random() < 0.5 else None
    settings = Structured(
        window=int(rng.integers(1, 12)), share=float(rng.uniform(0.2, 1)), distance=int(rng.integers(3))
    )
    codes = code_test(settings, table, [f"f{k}" for k in range(faults)], made.parts, settled=settled)
    spec = replace(made.specification, isolation=codes)
    program = specification_program(spec, len(made.inputs), DOUBLE)
    return replace(made, specification=spec, program=program, groups=codes.groups)


@needs_compiler
@pytest.mark.parametrize("seeds", cases([(6, 20, 39), range(60)], 1))
def test_any_code_is_read_as_the_monitor_reads_it(seeds: Iterable[int], tmp_path: Path) -> None:
    """Of any bank: every answer that there is."""
    seen: set[int] = set()
    for seed in seeds:
        rng = np.random.default_rng(seed)
        monitor = bank_monitor("dedicated", 5, 1, 3 * (seed % 3))
        made = with_codes(monitor, rng)
        data, n_u, spec = recorded(monitor, seed, 800), len(made.inputs), made.specification
        _, decisions = run_block(spec, initial_state(spec, 1), data[None])
        right = bank_expected(spec, decisions)
        (folder := tmp_path / str(seed)).mkdir()
        assert np.array_equal(CompiledExport(made, folder, "-O1").run(data[:, :n_u], data[:, n_u:]), right)
        place = len(made.residuals) + 5 + len(made.groups) + len(made.parts)
        seen |= set(right[:, place].astype(int).tolist())
    assert {ANSWERS[k] for k in seen} == set(ANSWERS)


@pytest.mark.parametrize("seed", cases(range(42), 7))
def test_structured_text_has_the_bits_of_the_monitor(seed: int) -> None:
    monitor = example(seed)
    made = monitor_program(monitor, missing="hold")
    data, n_u = recorded(monitor, seed, 200), len(made.inputs)
    block = FunctionBlock(function_block(made, "watch"))
    rows: list[list[Any]] = []
    for sample in data:
        out = block.step(sample[:n_u], sample[n_u:])
        row = [*out["residual"], out["statistic"], out["known"], out["decided"], out["alarm"]]
        row += [out["best"], *out["score"]] if "score" in out else []
        row += [*out["code"], out["answer"]] if "code" in out else []
        rows.append([*row, *out["part_statistic"], *out["fired"]])
    assert np.array_equal(np.array(rows, dtype=float), wanted(monitor, data))


@needs_compiler
@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("seed", cases(range(28), 2))
def test_units_have_the_bits_of_the_monitor(seed: int, version: str, tmp_path: Path) -> None:
    pytest.importorskip("fmpy", reason="there is no FMPy")
    from fmpy.validation import validate_fmu

    monitor = example(seed)
    unit = rs.export.to_fmu(monitor, tmp_path / "w.fmu", version=version, missing="hold", binary=True)
    assert list(validate_fmu(str(unit.path))) == []
    fmu, data = RunningFMU(unit.path), recorded(monitor, seed, 400)
    assert np.array_equal(fmu.run(data), wanted(monitor, data))
    fmu.close()


@pytest.mark.parametrize("seed", cases(range(28), 2))
def test_onnx_models_are_the_monitor_but_for_rounding(seed: int, tmp_path: Path) -> None:
    for package in ("onnx", "onnxruntime"):
        pytest.importorskip(package, reason=f"there is no {package}")
    monitor = example(seed)
    model = rs.export.to_onnx(monitor, tmp_path / "w.onnx", missing="hold")
    data = recorded(monitor, seed, 500)
    right = wanted(monitor, data)
    got = RunningModel(model.path).run(data)
    fine = ~(np.cumsum((np.abs(np.nan_to_num(data, posinf=0.0, neginf=0.0)) > 1e6).any(axis=1)) > 0)
    assert fine.sum() > 5
    assert np.allclose(got[fine], right[fine], rtol=1e-9, atol=1e-9)


@needs_compiler
@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("seed", cases(range(7), 2))
def test_the_self_test_of_a_bank_passes(seed: int, precision: str, tmp_path: Path) -> None:
    folder = rs.export.to_c(example(seed), tmp_path / "c", name="w", precision=precision, missing="hold")
    done = subprocess.run(["make", "test"], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "passed: 400 samples, 0 differences" in done.stdout
    strict = ["gcc", *STRICT, "w.c", "-o", "w.so", "-lm"]
    again = subprocess.run(strict, cwd=folder, capture_output=True, text=True, check=False)
    assert again.returncode == 0, again.stderr
    assert "fired[0]" in (folder / "w.h").read_text()
    if precision == "double":
        text = (folder / "w.c").read_text()
        (folder / "w.c").write_text(text.replace("decision->fired[i] = ", "decision->fired[i] = !"))
        other = subprocess.run(["make", "test"], cwd=folder, capture_output=True, text=True, check=False)
        assert other.returncode != 0
        assert "FAILED" in other.stdout
