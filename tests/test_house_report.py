"""The figures of a small house, counted by hand."""

from __future__ import annotations

from pathlib import Path

import pytest

from house_report import figures, main, mixins, single_importers, unused_options
from house_tree import House

FILES = {
    "__init__.py": '"""A package."""\nfrom residua.decide.one import One\n',
    "decide/__init__.py": '"""A room."""\n',
    "decide/one.py": '''"""One.

Two lines more.
"""
from typing import TYPE_CHECKING

import numpy as np

from residua.decide.helper import halved, Mixin

if TYPE_CHECKING:
    from residua.monitor.two import Two

_ROUNDING = 1e-9  # a comment


class One(Mixin):
    """A class."""

    def rank(self, M):
        """Return a rank."""
        text = """of
        two lines"""
        return np.linalg.matrix_rank(M, tol=1e-9), text


    def late(self, codes):
        from residua.monitor.two import Two

        return codes is None or isinstance(codes, Two)
''',
    "decide/helper.py": "def halved(x):\n    return x / 2 + 1e-12\n\nclass Mixin:\n    pass\n",
    "monitor/__init__.py": "",
    "monitor/two.py": "from residua.decide.one import One\nfrom residua import decide\n\n"
    "def Two(x):\n    return isinstance(x, (int, BankTest)) or decide\n",
    "design/__init__.py": "from residua.design.way import way\n__all__ = ['Way', 'way']\n",
    "design/way.py": "def way():\n    pass\n",
}


@pytest.fixture
def source(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        path = tmp_path / "residua" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return tmp_path


def test_every_figure_is_what_one_counts(source: Path) -> None:
    found = figures(House(source))
    assert found["files"] == "8"
    assert found["lines of code"] == str(1 + 0 + 14 + 4 + 0 + 4 + 2 + 2)
    assert found["lines of docstrings"] == "8"
    assert found["modules with one importer"] == "3"
    assert found["modules with one importer in their room, under 60 lines"] == "1"
    assert found["imports inside functions"] == "1"
    assert found["circles of imports at the top"] == "0"
    assert found["circles of imports, those for types too"] == "1 of 2 modules"
    assert found["isinstance on kinds of judges"] == "1 in 1 files"
    assert found["tests by None on kinds of judges"] == "1 in 1 files"
    assert (found["tolerance literals"], found["... distinct"], found["named tolerances"]) == ("3 in 2 files", "2", "1")
    assert (found["places that decide a rank"], found["... without evidence"]) == ("1", "1")
    assert found["body of a function: median, 95 %, longest"] == "1, 3, 3"


def test_fragments_and_mixins_are_named(source: Path) -> None:
    house = House(source)
    assert [(a.name, b.name) for a, b in single_importers(house, 60)] == [
        ("residua.decide.helper", "residua.decide.one")
    ]
    assert mixins(house) == ["residua.decide.helper.Mixin"]


def test_the_table_of_two_trees(source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "table.csv"
    assert main([str(source), str(source), "--names", "before", "after", "--csv", str(table)]) == 0
    lines = table.read_text(encoding="utf-8").splitlines()
    assert lines[:2] == ["figure,before,after", "files,8,8"]
    assert capsys.readouterr().out.splitlines()[1].split() == ["files", "8", "8"]


def test_weight_and_language_are_counted(tmp_path: Path) -> None:
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "one.py").write_text(
        '''"""What a module is for."""  # a comment
__all__ = ["Public", "called"]


def called(x, scale=1):
    """Return what is asked for."""
    return _twice(x) + _once(x, 2) + _twice(x) + inner(x)


def _twice(x, *, unused=1):
    """Return twice the value."""
    return x * unused


def _once(x, power=1):
    return x**power


def inner(x, offset=0):
    return x + offset


class Public:
    def method(self, x, option=None):
        """Whether it holds."""
        return x is option
''',
        encoding="utf-8",
    )
    house = House(tmp_path / "package")
    found = figures(house)
    assert found["private helpers with one use"] == "1 of 2"
    assert found['docstring summaries with "what"'] == "2 of 4"
    assert found["... that begin with what, which, whether, how, where, when"] == "2"
    assert found["comments in 100 lines of code"] == f"{100 / 12:.1f}"
    assert unused_options(house) == ["package.one._twice(unused)", "package.one.inner(offset)"]
    assert "... structured_bank" not in found  # a figure of this house alone
