"""What the page on clusters shows is run: its files, its commands, and what they print."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("pyspark", reason="PySpark is not installed (make test-cluster)")

PAGE = Path(__file__).resolve().parents[2] / "docs" / "clusters.rst"
ENVIRONMENT = {"SPARK_LOCAL_IP": "127.0.0.1", "SPARK_LOCAL_HOSTNAME": "localhost", "PYSPARK_PYTHON": sys.executable}


def blocks() -> list[tuple[str, str]]:
    """Return the captions of the blocks of code on the page, and what is in them."""
    page = PAGE.read_text(encoding="utf-8")
    found = re.findall(r"\.\. code-block:: \w+\n   :caption: (.+)\n\n((?:   .*\n|\n)+)", page)
    return [(caption, re.sub(r"(?m)^   ", "", text).strip() + "\n") for caption, text in found]


def run(folder: Path, *command: str) -> str:
    """Return what a command prints."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = {**os.environ, **ENVIRONMENT, "PATH": path}
    made = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=500)
    assert made.returncode == 0, made.stderr[-3000:]
    return made.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of the page, with a monitor and its records."""
    folder = tmp_path_factory.mktemp("page")
    for caption, text in blocks():
        if caption.endswith(".py"):
            (folder / caption).write_text(text, encoding="utf-8")
    run(folder, "python", "fit.py")
    run(folder, "python", "feed.py")
    return folder


@pytest.mark.campaign
def test_the_commands_of_the_page_do_what_it_says(folder: Path) -> None:
    if shutil.which("java") is None:
        pytest.skip("there is no Java, which Spark runs on")
    commands = [line[2:].split() for caption, text in blocks() if caption == "commands" for line in text.splitlines()]
    assert len(commands) == 7
    (promised,) = (text for caption, text in blocks() if caption == "printed")
    printed = {command[-1]: run(folder, *command) for command in commands[2:]}
    assert printed["look.py"] == promised
    assert run(folder, "python", "look.py") == promised  # after the second run of the stream too
    (said,) = re.findall(r"prints ``(\{.*?\})``", PAGE.read_text(encoding="utf-8"))
    assert printed["move.py"].strip() == said
    shown = [tuple(line.split()[:2]) for line in promised.splitlines()]
    assert sorted(pair[:2] for pair in eval(printed["batch.py"])) == sorted(shown)


@pytest.mark.parametrize("engine", ["ray", "dask"])
def test_batches_of_the_page_find_the_same_plants(engine: str, folder: Path) -> None:
    pytest.importorskip(engine, reason=f"{engine} is not installed (make test-cluster)")
    assert run(folder, "python", f"{engine}_batch.py").splitlines()[-1] == "['pump-23', 'pump-7', 'pump-7']"


def test_recordings_of_the_page_are_diagnosed(folder: Path) -> None:
    printed = run(folder, "python", "many.py").splitlines()
    assert [line.split()[0] for line in printed] == ["monday.npz", "tuesday.npz", "friday.npz"]
    assert "['level sensor']" in printed[1]
    assert printed[2].startswith("friday.npz [] friday.npz: missing column")
