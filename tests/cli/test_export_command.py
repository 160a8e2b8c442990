"""The command that writes a monitor as code."""

from __future__ import annotations

from pathlib import Path

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
