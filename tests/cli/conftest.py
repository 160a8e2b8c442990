"""Fixtures of the command line's tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from cli_examples import DISTURBED, PLANT, Residua, simulate, write_csv
from residua.cli import main


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a plant file, recordings, and a fitted monitor that the commands made."""
    folder = tmp_path_factory.mktemp("cli")
    (folder / "plant.toml").write_text(PLANT)
    (folder / "disturbed.toml").write_text(PLANT + DISTURBED)
    write_csv(folder / "normal.csv", simulate(3000, 1))
    write_csv(folder / "healthy.csv", simulate(400, 2))
    write_csv(folder / "faulty.csv", simulate(400, 3, sensor=0.5, from_=200))
    design = ["design", folder / "plant.toml", "-o", folder / "design.json", "--false-alarm-rate", "0.01"]
    assert main([*map(str, design), "--persistence", "10"]) == 0
    fit = ["fit", folder / "design.json", folder / "normal.csv", "-o", folder / "monitor.json"]
    assert main([*map(str, fit)]) == 0
    return folder


@pytest.fixture
def residua(capsys: pytest.CaptureFixture[str]) -> Residua:
    """Run a command: exit status, stdout, stderr."""

    def call(*argv: object) -> tuple[int, str, str]:
        capsys.readouterr()
        status = main([str(a) for a in argv])
        out = capsys.readouterr()
        return status, out.out, out.err

    return call
