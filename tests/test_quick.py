"""What ``make quick`` chooses to run, on a small repository of its own and on this one."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import quick

FILES = {
    "src/box/__init__.py": "from box.room import lamp\n",
    "src/box/room/__init__.py": "from box.room.bulb import lamp\nfrom box.room.chair import chair\n",
    "src/box/room/bulb.py": "from box.room.wire import wire\nlamp = wire\n",
    "src/box/room/chair.py": "chair = 2\n",
    "src/box/room/wire.py": "wire = 1\n",
    "src/box/room/colours.toml": "",
    "src/box/reader.py": "NAME = 'colours.toml'\n",
    "src/box/kernel.c": "",
    "src/box/fast.py": "from box import kernel\n",
    "docs/page.rst": "",
    "tests/helper.py": "import box as b\nlight = b.lamp\n",
    "tests/lit/conftest.py": "",
    "tests/lit/test_light.py": "from helper import light\ndef test_light():\n    assert light\n",
    "tests/lit/test_dark.py": "def test_dark():\n    assert True\n",
    "tests/test_chair.py": "import box\ndef test_chair():\n    assert box.room.chair.chair\n",
    "tests/test_seat.py": "from box.room import chair\ndef test_seat():\n    assert chair\n",
    "tests/test_reader.py": "from box.reader import NAME\nfrom box import fast\n",
    "tests/test_pages.py": "PAGES = 'docs'\n",
}


@pytest.fixture
def small(tmp_path: Path) -> quick.Repository:
    """A repository of a few files."""
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    return quick.Repository(tmp_path)


@pytest.mark.parametrize(
    ("changed", "tests"),
    [
        ("tests/test_seat.py", {"tests/test_seat.py"}),
        ("tests/helper.py", {"tests/lit/test_light.py"}),
        ("src/box/room/bulb.py", {"tests/lit/test_light.py"}),  # through two facades and a helper
        ("src/box/room/wire.py", {"tests/lit/test_light.py"}),  # no test names it
        ("src/box/room/chair.py", {"tests/test_chair.py", "tests/test_seat.py"}),  # a module and a name in it
        ("src/box/kernel.c", {"tests/test_reader.py"}),
        ("src/box/room/colours.toml", {"tests/test_reader.py"}),
        ("docs/page.rst", {"tests/test_pages.py"}),
        ("tests/lit/conftest.py", {"tests/lit/test_light.py", "tests/lit/test_dark.py"}),
    ],
)
def test_the_nearest_tests_are_chosen(small: quick.Repository, changed: str, tests: set[str]) -> None:
    assert small.tests_of(changed) == tests


def test_what_changed_comes_first_and_its_users_types_are_checked(small: quick.Repository) -> None:
    choice = quick.choose(small, ["src/box/room/chair.py", "tests/lit/test_dark.py", "src/box/deleted.py"])
    assert choice.tests[:2] == ("tests/lit/test_dark.py", "src/box/room/chair.py")
    assert set(choice.tests[2:]) == {"tests/test_chair.py", "tests/test_seat.py"}
    assert choice.types == ("src/box/room/__init__.py", "src/box/room/chair.py")


def test_the_core_runs_where_nothing_is_near_and_nothing_near_is_ever_left_out(
    small: quick.Repository, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert quick.choose(small, []).tests == quick.CORE
    monkeypatch.setattr(quick, "MOST", 0)
    choice = quick.choose(small, ["src/box/room/chair.py", "src/box/room/bulb.py", "tests/test_seat.py"])
    assert choice.tests[0] == "tests/test_seat.py"
    assert {"tests/test_chair.py", "tests/lit/test_light.py"} < set(choice.tests)
    assert choice.types == ("src/box/room/bulb.py", "src/box/room/chair.py")


def test_changed_is_what_differs_from_where_the_branch_left_main(small: quick.Repository) -> None:
    def git(*arguments: str) -> None:
        names = {f"GIT_{who}_{what}": "x" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}
        subprocess.run(["git", "-C", str(small.root), *arguments], env=os.environ | names, check=True)

    git("init", "-q", "-b", "main")
    git("add", ".")
    git("commit", "-q", "-m", "all")
    assert quick.changed_files(small.root, None)[1] == set()
    git("checkout", "-q", "-b", "mine")
    (small.root / "src/box/fast.py").write_text("fast = 1\n", encoding="utf-8")
    git("commit", "-q", "-a", "-m", "mine")
    git("checkout", "-q", "main")
    (small.root / "docs/page.rst").write_text("theirs", encoding="utf-8")
    git("commit", "-q", "-a", "-m", "theirs")
    git("checkout", "-q", "mine")
    (small.root / "src/box/reader.py").write_text("", encoding="utf-8")
    (small.root / "tests/test_new.py").write_text("", encoding="utf-8")
    assert quick.changed_files(small.root, None)[1] == {"src/box/fast.py", "src/box/reader.py", "tests/test_new.py"}
    assert quick.changed_files(small.root, "HEAD")[1] == {"src/box/reader.py", "tests/test_new.py"}
    with pytest.raises(SystemExit, match="no commit"):
        quick.changed_files(small.root, "elsewhere")


def test_no_test_begins_when_the_time_is_up(small: quick.Repository) -> None:
    def run(until: str) -> tuple[int, str]:
        paths = os.pathsep.join(map(str, (Path(quick.__file__).parent, small.root / "src", small.root / "tests")))
        command = [sys.executable, "-m", "pytest", "-q", "-p", "quick", "-p", "no:cacheprovider", "tests/test_seat.py"]
        environment = os.environ | {quick.UNTIL: until, "PYTHONPATH": paths}
        done = subprocess.run(command, cwd=small.root, env=environment, capture_output=True, text=True, check=False)
        return done.returncode, done.stdout

    status, printed = run("inf")
    assert status == 0
    assert "1 passed" in printed
    status, printed = run("0")
    assert status == quick._UNFINISHED
    assert "1 tests were not begun" in printed
    assert "1 skipped" in printed
    assert "passed" not in printed


@pytest.mark.parametrize(
    ("seconds", "body", "status", "verdict"),
    [(60, "True", 0, "good"), (-1, "True", quick.INCONCLUSIVE, "inconclusive"), (60, "False", 1, "BAD")],
)
def test_what_was_not_run_is_not_good(
    small: quick.Repository, capsys: pytest.CaptureFixture, seconds: float, body: str, status: int, verdict: str
) -> None:
    (small.root / "tests/test_one.py").write_text(f"def test_one():\n    assert {body}\n", encoding="utf-8")
    (small.root / "tests/quick.py").write_text(Path(quick.__file__).read_text(encoding="utf-8"), encoding="utf-8")
    (small.root / "ruff.toml").write_text("lint.select = []\nformat.exclude = ['*']\n", encoding="utf-8")
    choice = quick.Choice(("tests/test_one.py",), (), "")
    assert quick.run(choice, small.root, seconds) == status
    assert f"tests: {verdict}" in capsys.readouterr().out


def test_every_file_of_the_package_has_tests_near_to_it() -> None:
    repository = quick.Repository(quick.REPOSITORY)
    assert [path for path in quick.CORE if path not in repository.python] == []
    # Not those that only pass on names, nor the entry of ``python -m residua``, which is started and not imported.
    written = [path for path in repository.python if path.startswith("src/") and defines_something(path)]
    assert len(written) > 150
    assert [path for path in written if not repository.tests_of(path)] == []


def defines_something(path: str) -> bool:
    body = ast.parse((quick.REPOSITORY / path).read_text(encoding="utf-8")).body
    return any(isinstance(node, ast.FunctionDef | ast.ClassDef) for node in body)
