"""Importing the package is cheap: what only some users need is imported when it is used."""

from __future__ import annotations

import ast
import importlib
import json
import pickle
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import residua
from residua.design.catalogue import method

ROOT = Path(residua.__file__).parent
HEAVY = (
    "scipy.signal",
    "scipy.stats",
    "scipy.optimize",
    "scipy.sparse",
    "scipy.special",
    "matplotlib",
    "pandas",
    "polars",
    "pyarrow",
    "narwhals",
    "typer",
    "control",
    "clarabel",
    "cvxpy",
    "pyspark",
    "ray",
    "dask",
    "distributed",
    "joblib",
)


def loaded(use: str, module: str = "residua") -> set[str]:
    """Return the modules that a new process has after importing one and using it."""
    code = f"import json, sys, {module}; {use}; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout))


def of_the_package(names: set[str]) -> set[str]:
    return {name for name in names if name.split(".")[0] == "residua"}


def facades() -> list[Path]:
    """Return the files that hand on names."""
    return [path for path in sorted(ROOT.rglob("__init__.py")) if "hand_on(" in path.read_text(encoding="utf-8")]


def module_of(path: Path) -> str:
    return ".".join(["residua", *path.parent.relative_to(ROOT).parts])


def test_nothing_heavy_is_imported_by_any_name() -> None:
    assert set(HEAVY) & loaded("[getattr(residua, name) for name in residua.__all__]") == set()


def test_names_are_imported_when_they_are_first_asked_for() -> None:
    alone = loaded("residua.__all__, dir(residua)")
    assert of_the_package(alone) == {"residua", "residua.facade"}
    assert not {"numpy", "scipy"} & alone
    plants = of_the_package(loaded("residua.Plant"))
    assert "residua.plant.plant" in plants
    assert not [name for name in plants if name.split(".")[1:2] in (["design"], ["decide"], ["monitor"], ["identify"])]
    assert not [name for name in loaded("residua.Monitor") if name.startswith("residua.identify")]


def test_the_catalogue_of_methods_is_found_without_an_import_of_its_own() -> None:
    """The page on methods uses it so."""
    assert "residua.design.catalogue" in loaded("residua.design.catalogue.methods()")


@pytest.mark.parametrize("path", facades(), ids=module_of)
def test_no_room_imports_its_files(path: Path) -> None:
    """So that a file that needs its room waits for nothing that waits for the file, in whichever threads."""
    name = module_of(path)
    parents = {name.rsplit(".", k)[0] for k in range(name.count(".") + 1)}
    assert of_the_package(loaded("None", name)) == {*parents, "residua.facade"}


@pytest.mark.parametrize("path", facades(), ids=module_of)
def test_a_room_hands_on_what_its_stub_imports(path: Path) -> None:
    """To Python, to type checkers, and to whoever imports all names."""
    room = importlib.import_module(module_of(path))
    stub = ast.parse(path.with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [alias for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names]
    assert all(alias.asname == alias.name for alias in imports)  # else type checkers take the name as private
    assert sorted(alias.name for alias in imports) == room.__all__ == dir(room)  # whatever files are imported by now
    assert {name for name in room._places if isinstance(getattr(room, name), ModuleType)} <= {"coding"}
    assert all(isinstance(getattr(room, name), ModuleType) for name in room._modules)
    with pytest.raises(AttributeError, match=f"'{room.__name__}' has no attribute 'no_such_name'"):
        room.no_such_name  # noqa: B018


@pytest.mark.parametrize("first", ["import residua.identify.arx", "import residua.identify; residua.identify.arx"])
def test_a_function_hides_the_file_of_its_name_whichever_is_imported_first(first: str) -> None:
    code = (
        f"{first}; import residua.identify.equations, residua.identify; print(residua.identify.arx.__class__.__name__)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "function"


def test_a_method_is_found_in_a_process_that_has_not_used_it() -> None:
    record = pickle.dumps(method("kalman_filter"))
    code = f"import pickle; print(pickle.loads({record!r}).name)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "kalman_filter"


@pytest.mark.parametrize("seed", range(3))
def test_threads_that_import_at_the_same_time_meet_no_half_made_module(seed: int) -> None:
    done = subprocess.run([sys.executable, "-c", IN_THREADS, str(seed)], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


#: NumPy comes first: its own modules import one another, and it fails now and then where threads import it at once.
IN_THREADS = """
import importlib, random, sys, threading
import numpy.typing
import residua
sys.setswitchinterval(1e-6)
rooms = ("analysis", "decide", "design", "identify", "library", "linear", "monitor", "plant", "validate")
files = sorted({place for room in rooms for place in getattr(residua, room)._places.values()})
barrier = threading.Barrier(6)

def work(rng):
    barrier.wait()
    for _ in range(4):
        if rng.random() < 0.5:
            importlib.import_module(rng.choice(files))
        else:
            room = getattr(residua, rng.choice(rooms))
            getattr(room, rng.choice(room.__all__))

threads = [threading.Thread(target=work, args=(random.Random(f"{sys.argv[1]} {k}"),)) for k in range(6)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
"""
