"""What README and documentation show is what happens, and the reference names everything that is public."""

from __future__ import annotations

import doctest
import importlib
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
DOCS = REPOSITORY / "docs"
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
PAGES = sorted(page for page in DOCS.glob("*.rst") if ">>> " in page.read_text(encoding="utf-8"))
PUBLIC = (
    "residua",
    "analysis",
    "analysis.coding",
    "decide",
    "design",
    "errors",
    "export",
    "identify",
    "library",
    "linear",
    "monitor",
    "plant",
    "report",
    "validate",
)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to leave files in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def fenced(text: str, language: str) -> list[str]:
    """Return the blocks of a language in a Markdown text."""
    return re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)


def readme() -> str:
    return (REPOSITORY / "README.md").read_text(encoding="utf-8")


def test_the_readmes_python_prints_what_it_says(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = fenced(readme(), "python")
    (promised,) = fenced(readme(), "text")
    exec(compile(code, "README.md", "exec"), {"__name__": "readme"})
    assert capsys.readouterr().out == promised
    assert (here / "report.html").stat().st_size > 10_000
    assert len([line for line in code.splitlines() if line.strip()]) <= 22  # imports included


def test_the_readmes_picture_is_small() -> None:
    (picture,) = re.findall(r"!\[.*?\]\((.*?)\)", readme())
    assert 20_000 < (REPOSITORY / picture).stat().st_size < 250_000


def test_links_of_the_readme_lead_somewhere() -> None:
    for target in re.findall(r"\]\(([^)]+)\)", readme()):
        assert (REPOSITORY / target).exists(), target


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that the three-tank demo leaves."""
    folder = tmp_path_factory.mktemp("demo")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        ((_, status),) = after_demo(["residua demo three-tank --output ."])
    assert status == 0
    return folder


def test_the_readmes_commands_run(here: Path, demo: Path) -> None:
    (block,) = fenced(readme(), "sh")
    commands = [line.split("#")[0] for line in block.splitlines()]
    assert [command.split()[1] for command in commands] == ["analyze", "design", "fit", "run"]
    shutil.copytree(demo, here, dirs_exist_ok=True)
    outcomes = list(after_demo(commands))
    assert [status for _, status in outcomes] == [0, 0, 0, 1]


def test_the_commands_of_getting_started_print_what_it_says(here: Path, demo: Path) -> None:
    shutil.copytree(demo, here, dirs_exist_ok=True)
    text = (DOCS / "getting-started.rst").read_text(encoding="utf-8")
    (block,) = re.findall(r"code-block:: console\n\n(.*?)\n(?=\S)", text, flags=re.DOTALL)
    entries = [entry.split("\n", 1) for entry in re.split(r"^ +\$ ", block, flags=re.MULTILINE)[1:]]
    compare = doctest.OutputChecker().check_output
    statuses = []
    for (command, promised), (printed, status) in zip(
        entries, after_demo([command for command, _ in entries]), strict=True
    ):
        assert compare(promised, printed, FLAGS), f"{command}\n{printed}"
        statuses.append(status)
    assert statuses == [0, 0, 0, 0, 1]


def after_demo(commands: list[str]) -> Iterator[tuple[str, int]]:
    """Run each command in the folder of the three-tank demo; yield what it printed and its exit status."""
    runner = pytest.importorskip("typer.testing").CliRunner()
    from residua.cli.app import app

    for command in commands:
        name, *arguments = command.split()
        assert name == "residua"
        result = runner.invoke(app, arguments)
        yield result.output, result.exit_code


#: What pages need that is no dependency of the package.
NEEDED = {"export": ("onnx", "onnxruntime"), "fmu": ("fmpy",)}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_what_pages_show_is_what_happens(page: Path, here: Path) -> None:
    for package in NEEDED.get(page.stem, ()):
        pytest.importorskip(package, reason=f"there is no {package}")
    if page.stem == "fmu" and shutil.which("cc") is None:
        pytest.skip("there is no C compiler")
    pytest.importorskip("matplotlib").use("Agg")
    failed, tried = doctest.testfile(str(page), module_relative=False, optionflags=FLAGS)
    assert tried
    assert not failed


ALONE = """
import doctest, importlib.metadata, sys
page, flags, *brought = sys.argv[1:]
OWNERS = importlib.metadata.packages_distributions()

class Absent:  # what else is installed here, for tests or pages, and what others import where it is there
    @staticmethod
    def find_spec(name, path=None, target=None):
        owners = {owner.lower().replace("_", "-") for owner in OWNERS.get(name, ())}
        if owners and not owners & set(brought):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Absent)
import matplotlib
matplotlib.use("Agg")
failed, tried = doctest.testfile(page, module_relative=False, optionflags=int(flags))
assert tried and not failed
assert {"residua", "numpy", "matplotlib", "pandas"} <= set(sys.modules)
"""


def test_the_extra_all_brings_what_getting_started_imports(here: Path) -> None:
    page = DOCS / "getting-started.rst"
    assert "pip install '.[all]'" in page.read_text(encoding="utf-8")
    source = os.environ | {"PYTHONPATH": str(REPOSITORY / "src")}

    def run(brought: set[str], flags: int = FLAGS) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", ALONE, str(page), str(flags), *sorted(brought)]
        return subprocess.run(command, capture_output=True, text=True, env=source, check=False)

    brought = {"residua", *with_what_they_need({"residua[all]"})}
    done = run(brought)
    assert done.returncode == 0, done.stdout + done.stderr
    without = run(brought - {"pandas"}, FLAGS | doctest.FAIL_FAST)  # it is the first thing that fails
    assert "No module named 'pandas'" in without.stdout


def with_what_they_need(wanted: set[str]) -> set[str]:
    """Return the distributions that requirements bring, those of residua by this repository's definition."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    found: set[str] = set()
    left = [*wanted, *project["dependencies"]]
    while left:
        name, extras = re.match(r"([\w.-]+)(?:\[([\w,-]+)\])?", left.pop()).groups()  # pyright: ignore
        if name == "residua":
            left += [entry for extra in extras.split(",") for entry in project["optional-dependencies"][extra]]
        elif (name := name.lower().replace("_", "-")) not in found:
            found.add(name)
            try:
                needs = importlib.metadata.requires(name) or []
            except importlib.metadata.PackageNotFoundError:  # for another system
                continue
            left += [entry for entry in needs if "extra ==" not in entry]
    return found


def test_the_reference_names_everything_that_is_public() -> None:
    listed = []
    for page in (DOCS / "api").glob("*.rst"):
        for section in page.read_text(encoding="utf-8").split(".. currentmodule:: ")[1:]:
            module = importlib.import_module(section.split()[0])
            listed += [getattr(module, name) for name in re.findall(r"^   (\w+)$", section, flags=re.MULTILINE)]
    for name in PUBLIC:
        module = importlib.import_module("residua" if name == "residua" else f"residua.{name}")
        for entry in (entry for entry in dir(module) if not entry.startswith("_")):
            value = getattr(module, entry)
            if callable(value):
                assert value in listed, f"{module.__name__}.{entry} is missing from docs/api"
