"""The command that writes a monitor as code."""

from __future__ import annotations

from pathlib import Path

import pytest

import residua as rs
from cli_examples import Residua


def watch() -> rs.Monitor:
    plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"], name="Tank 7 (east)")
    return rs.Monitor(rs.design.kalman_filter(plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)))


def test_the_command_writes_what_the_function_writes(tmp_path: Path, residua: Residua) -> None:
    watch().save(tmp_path / "m.json")
    status, out, err = residua("export", tmp_path / "m.json", "-o", tmp_path / "no")
    assert status == 2
    assert "--hold exports it with the last value held" in err
    status, out, err = residua("export", tmp_path / "m.json", "-o", tmp_path / "c", "--hold", "--name", "w")
    assert status == 0, err
    assert "w.h" in out
    other = rs.export.to_c(watch(), tmp_path / "other", name="w", missing="hold")
    assert all(one.read_bytes() == (other / one.name).read_bytes() for one in (tmp_path / "c").iterdir())
    status, out, err = residua("export", tmp_path / "m.json", "--to", "st", "-o", tmp_path / "c", "--hold")
    assert status == 2
    assert "--overwrite" in err
    status, out, err = residua("export", tmp_path / "m.json", "--to", "st", "-o", tmp_path / "st", "--hold")
    assert status == 0, err
    assert "tank_7_east.st" in out


def test_units_are_written_with_what_is_inside_and_what_was_renamed(tmp_path: Path, residua: Residua) -> None:
    plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["alarm"], name="Tank 7 (east)")
    made = rs.Monitor(rs.design.kalman_filter(plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)))
    made.save(tmp_path / "m.json")
    for to, version in (("fmu2", "2.0"), ("fmu3", "3.0")):
        target = tmp_path / to / "w.fmu"
        status, out, err = residua("export", tmp_path / "m.json", "--to", to, "-o", target, "--hold")
        assert status == 0, err
        assert "w.fmu, with" in " ".join(out.split())
        assert "signal 'alarm' is 'alarm_1' in the unit" in " ".join(out.split())
        other = rs.export.to_fmu(made, tmp_path / "other" / to / "w.fmu", version=version, missing="hold")
        assert target.read_bytes() == other.path.read_bytes()
        status, out, err = residua("export", tmp_path / "m.json", "--to", to, "-o", target, "--hold")
        assert status == 2
        assert "--overwrite" in err
    status, out, err = residua(
        "export", tmp_path / "m.json", "--to", "fmu3", "-o", tmp_path / "no", "--precision", "float", "--hold"
    )
    assert status == 2
    assert "computes in double precision" in err
    assert not (tmp_path / "no").exists()


def test_onnx_models_are_written_with_their_bound(tmp_path: Path, residua: Residua) -> None:
    pytest.importorskip("onnx")
    watch().save(tmp_path / "m.json")
    command = ("export", tmp_path / "m.json", "--to", "onnx", "--hold", "-o")
    status, out, err = residua(*command, tmp_path / "d" / "w.onnx", "--precision", "float")
    assert status == 0, err
    assert "w.onnx, residuals off by rounding: " in " ".join(out.split())
    other = rs.export.to_onnx(watch(), tmp_path / "w.onnx", precision="float", missing="hold")
    assert (tmp_path / "d" / "w.onnx").read_bytes() == other.path.read_bytes()
    status, out, err = residua(*command, tmp_path / "d", "--name", "w")
    assert status == 2
    assert "--overwrite" in err
