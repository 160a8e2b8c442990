"""What is released: the smoke test that every wheel has to pass, and what may be in wheels and source distributions."""

from __future__ import annotations

import io
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

import distribution
import residua as rs

REPOSITORY = Path(__file__).resolve().parent.parent
WHEEL = (
    "residua/__init__.py",
    "residua/py.typed",
    "residua/report/static/page.js",
    "residua/export/fmi/fmu.c",
    "residua/export/fmi/headers/fmi3Functions.h",
    "residua-1.0.dist-info/licenses/src/residua/export/fmi/LICENSE.txt",
    *(f"{kernel}.abi3.so" for kernel in distribution.KERNELS),
    "residua-1.0.dist-info/licenses/LICENSE",
)
SOURCE = (
    *(f"src/{kernel}.c" for kernel in distribution.KERNELS),
    "src/residua/linear/systems/_filter.h",
    "setup.py",
    "LICENSE",
    "CHANGELOG.md",
    "README.md",
    "tests/smoke.py",
    "docs/conf.py",
    "examples/plant.toml",
)


def wheel(folder: Path, *names: str, tag: str = "cp311-abi3-linux_x86_64") -> Path:
    with zipfile.ZipFile(folder / f"residua-1.0-{tag}.whl", "w") as archive:
        for name in names:
            archive.writestr(name, "")
    return folder / f"residua-1.0-{tag}.whl"


def source(folder: Path, *names: str) -> Path:
    with tarfile.open(folder / "residua-1.0.tar.gz", "w:gz") as archive:
        for name in names:
            archive.addfile(tarfile.TarInfo(f"residua-1.0/{name}"), io.BytesIO())
    return folder / "residua-1.0.tar.gz"


def test_what_belongs_into_a_distribution_is_all_there_and_nothing_else(tmp_path: Path) -> None:
    assert distribution.complaints(wheel(tmp_path, *WHEEL)) == []
    assert distribution.complaints(source(tmp_path, *SOURCE)) == []


@pytest.mark.parametrize("left_out", WHEEL)
def test_what_a_wheel_lacks_is_said(tmp_path: Path, left_out: str) -> None:
    (said,) = distribution.complaints(wheel(tmp_path, *(name for name in WHEEL if name != left_out)))
    assert said.startswith("missing: ")


@pytest.mark.parametrize("left_out", SOURCE)
def test_what_a_source_distribution_lacks_is_said(tmp_path: Path, left_out: str) -> None:
    (said,) = distribution.complaints(source(tmp_path, *(name for name in SOURCE if name != left_out)))
    assert said.startswith("missing: ")


@pytest.mark.parametrize("further", ["tests/test_x.py", "residua/x.pyc", "residua/linear/_x.so"])
def test_what_a_wheel_should_not_bring_is_said(tmp_path: Path, further: str) -> None:
    assert distribution.complaints(wheel(tmp_path, *WHEEL, further)) == [f"not wanted: {further}"]


def test_a_wheel_for_one_python_and_a_source_with_something_built_are_refused(tmp_path: Path) -> None:
    (said,) = distribution.complaints(wheel(tmp_path, *WHEEL, tag="cp312-cp312-linux_x86_64"))
    assert "cp311-abi3" in said
    assert distribution.complaints(source(tmp_path, *SOURCE, "src/x.so")) == ["not wanted: src/x.so"]


def test_no_compiler_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", "src")
    environment = distribution.without_compiler(tmp_path)
    assert "PYTHONPATH" not in environment
    assert shutil.which("gcc", path=environment["PATH"]) is None
    (tmp_path / "gcc").write_text("", encoding="utf-8")
    (tmp_path / "gcc").chmod(0o755)
    with pytest.raises(SystemExit, match=r"has compilers.*gcc"):
        distribution.without_compiler(tmp_path)


def run_smoke(script: Path, **settings: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY / "src")} | settings
    return subprocess.run([sys.executable, str(script)], env=environment, capture_output=True, text=True, check=False)


def test_the_smoke_test_gives_the_same_residuals_with_and_without_the_kernel(tmp_path: Path) -> None:
    script = Path(shutil.copy(distribution.SMOKE, tmp_path))
    runs = [run_smoke(script, RESIDUA_NO_COMPILED=setting).stdout.split() for setting in ("0", "1")]
    assert [run[:2] for run in runs] == [["residua", rs.__version__]] * 2
    assert runs[1][2] == "numpy"
    assert runs[0][3] == runs[1][3]


def test_the_smoke_test_refuses_the_source_tree() -> None:
    done = run_smoke(distribution.SMOKE)
    assert done.returncode != 0
    assert "is the source, not an installation" in done.stderr


def test_every_place_names_the_same_versions_of_python() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    classifiers = re.findall(r"Python :: (3\.\d+)", "\n".join(project["project"]["classifiers"]))
    assert [f"cp{version.replace('.', '')}-*" for version in classifiers] == project["tool"]["cibuildwheel"]["build"]
    assert project["project"]["requires-python"] == f">={classifiers[0]}"
    workflow = (REPOSITORY / ".github/workflows/tests.yml").read_text(encoding="utf-8")
    (tested,) = re.findall(r"^ +python: \[(.*)\]$", workflow, flags=re.MULTILINE)
    assert re.findall(r'"([\d.]+)"', tested) == classifiers
    assert project["project"]["version"] == rs.__version__
