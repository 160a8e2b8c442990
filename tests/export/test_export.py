"""Folders of exported code: what is in them, what a monitor may not do to be exported, and what bad input gives."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import residua as rs
from compiled_exports import STRICT, CompiledExport
from residua.errors import DataError, ModelError, NotFittedError, SettingError
from residua.export.identifiers import comment_text, identifier
from residua.export.monitor_program import FLOAT, monitor_program
from residua.export.selftest import comparison, rounding_bound
from structured_text import FunctionBlock

needs_compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc")
needs_make = pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
needs_cppcheck = pytest.mark.skipif(shutil.which("cppcheck") is None, reason="there is no cppcheck")


def tank(noise: bool = True) -> rs.Plant:
    plant = rs.Plant(
        [[0.9, 0.05], [0.0, 0.8]], [[0.1], [0.2]], np.eye(2), dt=1, inputs=["valve"], outputs=["level", "flow"],
        units={"level": "cm", "flow": "l/min"}, name="Tank 7 (east)",
    )  # fmt: skip
    plant = plant.with_operating_point(inputs=[2.0], outputs=[30.0, 4.0]).with_sensor_faults()
    return plant.with_noise(process=1e-4 * np.eye(2), measurement=1e-2 * np.eye(2)) if noise else plant


def watch(test: Any = None, isolate: Any = "auto") -> rs.Monitor:
    return rs.Monitor(rs.design.kalman_filter(tank()), test=test, isolate=isolate)


@needs_compiler
@needs_make
@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("flags", ["-O0", "-O3"])
def test_the_self_test_passes_and_notices_another_number(tmp_path: Path, precision: str, flags: str) -> None:
    monitor = watch(rs.decide.CUSUM(mean_time_between_false_alarms=1e4))
    folder = rs.export.to_c(monitor, tmp_path / "c", precision=precision, missing="hold")
    assert sorted(one.name for one in folder.iterdir()) == ["Makefile", "selftest.c", "tank_7_east.c", "tank_7_east.h"]
    made = subprocess.run(["make", "test", f"CFLAGS={flags}"], cwd=folder, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stdout + made.stderr
    assert "passed: 400 samples, 0 differences" in made.stdout
    code = (folder / "tank_7_east.c").read_text()
    (folder / "tank_7_east.c").write_text(re.sub(r"( offset\[3\] = \{\s+)", r"\g<1>1 + ", code))
    other = subprocess.run(["make", "test"], cwd=folder, capture_output=True, text=True, check=False)
    assert other.returncode != 0
    assert "FAILED" in other.stdout


@needs_compiler
def test_single_precision_stays_within_its_bound(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    for order in (0, 1, 3, 8):
        A = rng.standard_normal((order, order))
        A *= 0.9 / max(np.abs(np.linalg.eigvals(A)).max(initial=0.0), 1e-3)
        plant = rs.Plant(A, rng.standard_normal((order, 2)), rng.standard_normal((3, order)), dt=1)
        plant = plant.with_sensor_faults().with_noise(process=1e-2, measurement=1e-1)
        plant = plant.with_operating_point(outputs=[31.7, -3.3, 0.1])
        made = monitor_program(rs.Monitor(rs.design.kalman_filter(plant)), precision=FLOAT, missing="hold")
        spec, one = made.specification, comparison(made)
        data = np.hstack([one.u, one.y])
        bound = rounding_bound(spec, np.nanmax(np.abs(data - spec.offset), axis=0))
        (folder := tmp_path / str(order)).mkdir()
        out = CompiledExport(made, folder, "-O2").run(one.u, one.y)
        off = np.abs(out[:, :3] - one.residuals)[one.decided].max(axis=0)
        assert (off <= bound).all()
        assert (off > 1e-4 * bound).any()  # a bound that says something


def test_a_header_names_channels_units_and_groups(tmp_path: Path) -> None:
    text = (rs.export.to_c(watch(), tmp_path, name="w", missing="hold") / "w.h").read_text()
    for line in ("u[0]  valve", "y[0]  level [cm]", "y[1]  flow [l/min]", "score[0]  level sensor"):
        assert line in text
    assert "its last value is held; the monitor it was made from predicts through it" in text
    assert "at most" not in text
    text = (rs.export.to_c(watch(), tmp_path / "f", name="w", missing="hold", precision="float") / "w.h").read_text()
    assert "off by at most" in text


@pytest.mark.parametrize(
    ("test", "isolate", "said"),
    [
        (rs.decide.SPRT(), None, r"test .* \(SPRTTest\) cannot be exported"),
        (rs.decide.PageHinkley(), None, "cannot be exported: MultiscaleEWMA, NormThreshold"),
        (rs.decide.Adaptive(relative=0.05), None, "cannot be exported"),
        (rs.decide.CUSUM(), rs.decide.Likelihood(), r"isolation .* cannot be exported: Directional can"),
        (None, rs.decide.Matched(), "cannot be exported"),
    ],
)
def test_what_code_cannot_hold_is_refused_with_its_reason(test: Any, isolate: Any, said: str, tmp_path: Path) -> None:
    for write in (rs.export.to_c, rs.export.to_structured_text):
        with pytest.raises(SettingError, match=said):
            write(watch(test, isolate), tmp_path / "none", missing="hold")
        assert not (tmp_path / "none").exists()


def test_missing_outputs_of_kalman_filters_and_monitors_without_thresholds_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="goes on through missing outputs"):
        rs.export.to_c(watch(), tmp_path / "none")
    observer = rs.Monitor(rs.design.unknown_input_observer(tank(noise=False)).residual_generator())
    with pytest.raises(NotFittedError, match="has no threshold: fit"):
        rs.export.to_c(observer, tmp_path / "none")
    with pytest.raises(ModelError, match="only a Monitor"):
        rs.export.to_c(rs.design.kalman_filter(tank()), tmp_path / "none")  # pyright: ignore[reportArgumentType]
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"name": "2 tanks"}, "'monitor_2_tanks' would do"),
        ({"name": "while"}, "'while_1' would do"),
        ({"name": "a__b"}, "'a_b' would do"),
        ({"name": 3}, "name must be letters"),
        ({"precision": "half"}, "precision must be 'double' or 'float'"),
        ({"missing": "guess"}, "missing must be"),
    ],
)
def test_bad_options(options: dict[str, Any], said: str, tmp_path: Path) -> None:
    with pytest.raises(SettingError, match=said):
        rs.export.to_c(watch(), tmp_path / "none", **({"missing": "hold"} | options))


def test_a_folder_is_not_overwritten_unless_asked(tmp_path: Path) -> None:
    rs.export.to_c(watch(), tmp_path / "c", name="w", missing="hold")
    before = (tmp_path / "c" / "w.c").read_text()
    with pytest.raises(DataError, match="has 'Makefile' in it: name another folder, or ask to overwrite"):
        rs.export.to_c(watch(), tmp_path / "c", name="w", missing="hold")
    rs.export.to_c(watch(rs.decide.EWMA()), tmp_path / "c", name="w", missing="hold", overwrite=True)
    assert (tmp_path / "c" / "w.c").read_text() != before
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="is a file: name a folder"):
        rs.export.to_c(watch(), tmp_path / "file", missing="hold")
    with pytest.raises(DataError, match="name a folder that can be made"):
        rs.export.to_c(watch(), tmp_path / "file" / "below", missing="hold")


def test_names_of_users_end_no_comment_and_break_no_line() -> None:
    for text in ("a */ int main", "(* b *) c", "x\\\ny", "??/", "Füllstand\x1b[31m"):
        plain = comment_text(text)
        assert plain.isascii()
        assert plain.isprintable()
        assert not any(mark in plain for mark in ("*/", "/*", "(*", "*)", "??", "\\"))
    assert identifier("Füllstand 3") == "f_llstand_3"
    assert identifier("7") == "monitor_7"
    assert identifier("") == "monitor"


@needs_compiler
@pytest.mark.parametrize("precision", ["double", "float"])
def test_code_of_odd_names_and_without_inputs_compiles(precision: str, tmp_path: Path) -> None:
    plant = rs.Plant(
        [[0.9]], np.zeros((1, 0)), [[1.0], [2.0]], dt=1, outputs=["T_1 (°C) */", 'p "x" ??/'], name="Ofen */ (* 3"
    )
    plant = plant.with_sensor_faults().with_noise(process=1e-3, measurement=1e-2)
    monitor = rs.Monitor(rs.design.kalman_filter(plant))
    folder = rs.export.to_c(monitor, tmp_path / "c", precision=precision, missing="hold")
    command = ["gcc", *STRICT, "ofen_3.c", "-o", "ofen.so", "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rs.export.to_structured_text(monitor, tmp_path / "st", precision=precision, missing="hold")
    FunctionBlock((tmp_path / "st" / "ofen_3.st").read_text())


@needs_cppcheck
@pytest.mark.parametrize("test", [None, rs.decide.CUSUM(), rs.decide.GLR(window=5)])
def test_cppcheck_finds_nothing(test: Any, tmp_path: Path) -> None:
    folder = rs.export.to_c(watch(test), tmp_path / "c", name="w", missing="hold")
    command = ["cppcheck", "--std=c99", "--enable=warning,portability,performance", "--error-exitcode=3", "w.c"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


#: Advisory rules of MISRA C:2012 that the code does not follow: parentheses around products in sums, macros that only
#: callers need, constants of one function beside it.
DEVIATIONS = {"12.1", "2.5", "8.9"}


@needs_cppcheck
@pytest.mark.parametrize("kind", ["whole", "bank"])
def test_no_required_rule_of_misra_is_broken(kind: str, tmp_path: Path) -> None:
    bank = rs.Monitor(rs.design.sensor_fault_bank(tank()), test=rs.decide.NormThreshold(threshold=5.0, window=3))
    monitor = bank if kind == "bank" else watch(rs.decide.CUSUM())
    folder = rs.export.to_c(monitor, tmp_path / "c", name="w", missing="hold")
    command = ["cppcheck", "--addon=misra", "--std=c99", "w.c"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if "misra" in done.stderr and "misra-c2012" not in done.stderr:
        pytest.skip("this cppcheck has no addon for MISRA")
    found = set(re.findall(r"misra-c2012-(\d+\.\d+)", done.stderr))
    assert found <= DEVIATIONS, done.stderr
