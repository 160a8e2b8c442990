"""What README and documentation show is what happens, and the reference names everything that is public."""

from __future__ import annotations

import doctest
import importlib
import importlib.metadata
import json
import os
import re
import runpy
import shutil
import socketserver
import subprocess
import sys
import textwrap
import threading
import tomllib
from collections.abc import Iterator
from email import message_from_bytes
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from residua.recording.table_writer import write_table

REPOSITORY = Path(__file__).resolve().parent.parent
DOCS = REPOSITORY / "docs"
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
WRITTEN = sorted([*DOCS.glob("*.rst"), *DOCS.glob("how-to/*.rst")])
PAGES = [page for page in WRITTEN if ">>> " in page.read_text(encoding="utf-8")]
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


def project() -> dict[str, Any]:
    """Return the definition of the package."""
    return tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def readme() -> str:
    return (REPOSITORY / "README.md").read_text(encoding="utf-8")


def test_the_readmes_python_prints_what_it_says(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = fenced(readme(), "python")
    (promised,) = fenced(readme(), "text")
    exec(compile(code, "README.md", "exec"), {"__name__": "readme"})
    assert capsys.readouterr().out == promised
    assert (here / "report.html").stat().st_size > 10_000
    assert len([line for line in code.splitlines() if line.strip()]) <= 12  # imports included
    assert len(readme().splitlines()) <= 120


def test_the_readmes_picture_is_small() -> None:
    (picture,) = re.findall(r"!\[.*?\]\((.*?)\)", readme())
    assert 20_000 < (REPOSITORY / picture).stat().st_size < 250_000


def test_the_readmes_picture_is_not_older_than_its_page() -> None:
    image = pytest.importorskip("PIL.Image")
    make_picture = runpy.run_path(str(DOCS / "make_picture.py"))
    with image.open(DOCS / "_static" / "report.png") as picture:
        assert picture.info[make_picture["KEY"]] == make_picture["sources"](), "run: python docs/make_picture.py"


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


def test_the_readmes_commands_run(here: Path) -> None:
    (block,) = fenced(readme(), "sh")
    rng = np.random.default_rng(0)
    valve = np.repeat(rng.uniform(1, 3, 100), 30)
    level = np.convolve(valve, 0.1 * 0.9 ** np.arange(100))[: len(valve)]
    for name, offset in (("normal", 0.0), ("today", 0.5 * (np.arange(len(valve)) > 2000))):
        levels = level + 0.02 * rng.standard_normal((2, len(valve))) + np.outer([1, 0], np.ones(len(valve)) * offset)
        write_table(
            here / f"{name}.csv", {"time": np.arange(len(valve)), "valve": valve, "l1": levels[0], "l2": levels[1]}
        )
    commands = [line.split("#")[0] for line in block.splitlines()]
    (_, learnt), (printed, ran) = after_demo(commands)
    assert (learnt, ran) == (0, 1)
    assert "l1" in printed.splitlines()[0]
    assert (here / "report.html").stat().st_size > 10_000


def test_the_commands_of_getting_started_print_what_it_says(here: Path, demo: Path) -> None:
    shutil.copytree(demo, here, dirs_exist_ok=True)
    assert printed_as_promised("getting-started") == [0, 0, 0, 1]


def test_the_commands_for_a_log_print_what_it_says(here: Path) -> None:
    doctest.testfile(str(DOCS / "i-have-a-log.rst"), module_relative=False, optionflags=FLAGS)  # it writes the logs
    assert printed_as_promised("i-have-a-log") == [0, 1]
    assert (here / "today.html").stat().st_size > 10_000


def printed_as_promised(page: str) -> list[int]:
    """Run the commands of a page, check that each prints what stands below it, and return their exit statuses."""
    text = (DOCS / f"{page}.rst").read_text(encoding="utf-8")
    blocks = "".join(re.findall(r"code-block:: console\n\n(.*?\n)\n(?=\S)", text, flags=re.DOTALL))
    entries = [entry.split("\n", 1) for entry in re.split(r"^ +\$ ", blocks, flags=re.MULTILINE)[1:]]
    done = list(after_demo([command for command, _ in entries]))
    for (command, promised), (printed, _) in zip(entries, done, strict=True):
        assert doctest.OutputChecker().check_output(promised, printed, FLAGS), f"{command}\n{printed}"
    return [status for _, status in done]


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
NEEDED = {"export": ("onnx", "onnxruntime"), "fmu": ("fmpy",), "simulink": ("control",)}


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
assert {"residua", "numpy", "matplotlib"} <= set(sys.modules)
"""


@pytest.mark.parametrize(("page", "last"), [("getting-started", "pandas"), ("export", "onnxruntime")])
def test_the_extra_all_brings_what_pages_import(here: Path, page: str, last: str) -> None:
    source = os.environ | {"PYTHONPATH": str(REPOSITORY / "src")}

    def run(folder: str, brought: set[str], flags: int = FLAGS) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", ALONE, str(DOCS / f"{page}.rst"), str(flags), *sorted(brought)]
        (here / folder).mkdir()
        return subprocess.run(command, capture_output=True, text=True, env=source, check=False, cwd=here / folder)

    brought = {"residua", *with_what_they_need({"residua[all]"})}
    done = run("all", brought)
    assert done.returncode == 0, done.stdout + done.stderr
    without = run("less", brought - {last}, FLAGS | doctest.FAIL_FAST)  # it is the first thing that fails
    assert f"No module named '{last}'" in without.stdout


def test_the_install_page_lists_all_extras() -> None:
    page = (DOCS / "install.rst").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^``(\w+)`` +.*?  +(\S.*(?:\n  .*)?)$", page, flags=re.MULTILINE))
    extras = project()["optional-dependencies"]
    assert set(rows) == set(extras) - {"test", "test-cluster", "bench", "mutants", "dist", "docs"}
    for extra in set(rows) - {"all"}:
        brought = {re.split(r"[^\w-]", entry)[0] for entry in extras[extra]}
        assert brought - {"residua"} <= set(re.findall(r"[\w-]+", rows[extra])), extra
    above = set(re.findall(r"^``(\w+)`` ", page.split("``all``")[0], flags=re.MULTILINE))
    assert above == set(re.findall(r"\w+", extras["all"][0].split("[")[1]))


def test_the_citation_is_of_this_version() -> None:
    version = project()["version"]
    assert f"\nversion: {version}\n" in (REPOSITORY / "CITATION.cff").read_text(encoding="utf-8")
    assert f"version = {{{version}}}" in (DOCS / "how-to" / "cite.rst").read_text(encoding="utf-8")


def with_what_they_need(wanted: set[str]) -> set[str]:
    """Return the distributions that requirements bring, those of residua by this repository's definition."""
    found: set[str] = set()
    left = [*wanted, *project()["dependencies"]]
    while left:
        name, extras = re.match(r"([\w.-]+)(?:\[([\w,-]+)\])?", left.pop()).groups()  # pyright: ignore
        if name == "residua":
            left += [entry for extra in extras.split(",") for entry in project()["optional-dependencies"][extra]]
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


class Mailbox(socketserver.StreamRequestHandler):
    """Takes mail as an SMTP server does, into the list ``mails`` of its server."""

    def handle(self) -> None:
        self.wfile.write(b"220 here\r\n")
        for line in self.rfile:
            command = line[:4].upper()
            if command == b"DATA":
                self.wfile.write(b"354 go on\r\n")
                self.server.mails.append(b"".join(iter(self.rfile.readline, b".\r\n")))  # pyright: ignore
            self.wfile.write(b"221 bye\r\n" if command == b"QUIT" else b"250 fine\r\n")


def test_the_program_that_mails_alarms(here: Path, demo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (DOCS / "how-to" / "e-mail.rst").read_text(encoding="utf-8")
    program, sink = (
        textwrap.dedent(re.findall(rf"code-block:: {language}\n\n(.*?)\n(?=\S)", page, flags=re.DOTALL)[0])
        for language in ("python", "toml")
    )
    shutil.copytree(demo, here, dirs_exist_ok=True)
    (here / "mail_alarm.py").write_text(program, encoding="utf-8")
    source = '[[sources]]\nkind = "replay"\nfile = "leak.csv"\nspeed = 0\n[store]\nfile = "live.db"\n'
    python = sink.replace('"python"', json.dumps(sys.executable))
    (here / "live.toml").write_text(
        f'[[monitors]]\nfile = "tank.json"\nplants = ["north"]\n{source}{python}', encoding="utf-8"
    )
    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Mailbox) as server:
        server.mails = []  # pyright: ignore
        threading.Thread(target=server.serve_forever).start()
        settings = {"MAIL_FROM": "tank@example.org", "MAIL_TO": "me@example.org", "SMTP_HOST": "127.0.0.1"}
        for name, value in {**settings, "SMTP_PORT": str(server.server_address[1])}.items():
            monkeypatch.setenv(name, value)
        ((printed, status),) = after_demo(["residua live live.toml"])
        server.shutdown()
        mails = [message_from_bytes(mail) for mail in server.mails]  # pyright: ignore
    assert status == 1, printed
    assert [mail["Subject"].split(",")[0] for mail in mails] == ["north: raised", "north: renamed", "north: confirmed"]
    assert mails[-1]["Subject"] == "north: confirmed, leak 3 (good match)"
    assert len({mail["Message-ID"] for mail in mails}) == 3
