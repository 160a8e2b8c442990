"""Guards of the evidence: every ``raise AccuracyError`` of the package, and the tests that trip them.

A test says which guards it trips, and is watched while it runs: it fails when one of them is not reached::

    @trips("design.core.generator:make_generator")
    def test_an_unstable_filter_cannot_be_made() -> None: ...

A guard is called by module and function, with its number where a function has several (``:2``).
``tests/test_house.py`` asks that every guard has such a test.
"""

from __future__ import annotations

import ast
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from house_tree import SOURCE
from residua.errors import AccuracyError

PACKAGE = SOURCE / "residua"
TESTS = Path(__file__).resolve().parent

#: What a test says of itself: ``trips("module:function", ...)``.
trips = pytest.mark.trips


def _raised(tree: ast.AST, function: str = "") -> Iterator[tuple[str, int, int]]:
    """Yield the function and the first and last line of each error of accuracy that is raised or returned."""
    for node in ast.iter_child_nodes(tree):
        own = node.name if isinstance(node, ast.FunctionDef) else function
        made = node.exc if isinstance(node, ast.Raise) else node.value if isinstance(node, ast.Return) else None
        if isinstance(made, ast.Call) and isinstance(made.func, ast.Name) and made.func.id == "AccuracyError":
            yield function, node.lineno, node.end_lineno or node.lineno
        yield from _raised(node, own)


@cache
def guards() -> dict[str, tuple[str, int, int]]:
    """Return for each guard its file and lines."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        by_function = defaultdict(list)
        text = path.read_text()
        for function, *lines in _raised(ast.parse(text)) if "AccuracyError(" in text else ():
            by_function[function].append(lines)
        module = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        for function, places in by_function.items():
            for k, (first, last) in enumerate(places, 1):
                key = f"{module}:{function}" + (f":{k}" if len(places) > 1 else "")
                found[key] = (str(path), first, last)
    return found


def claimed() -> dict[str, list[str]]:
    """Return for each guard that a test says it trips the files of these tests, as their syntax trees tell it."""
    found: dict[str, list[str]] = defaultdict(list)
    for path in sorted(TESTS.rglob("*.py")):
        text = path.read_text()
        for node in ast.walk(ast.parse(text)) if "trips(" in text else ():
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "trips":
                for argument in node.args:
                    if isinstance(argument, ast.Constant):
                        found[argument.value].append(str(path.relative_to(TESTS.parent)))
    return found


@contextmanager
def watched(monkeypatch: pytest.MonkeyPatch) -> Iterator[set[str]]:
    """Collect the guards that raise."""
    raised: set[str] = set()
    make = AccuracyError.__init__

    def noted(self: AccuracyError, *told: Any) -> None:
        frame = sys._getframe(1)
        at = frame.f_code.co_filename, frame.f_lineno
        raised.update(key for key, (path, first, last) in guards().items() if path == at[0] and first <= at[1] <= last)
        make(self, *told)

    with monkeypatch.context() as patch:
        patch.setattr(AccuracyError, "__init__", noted)
        yield raised


@pytest.fixture(autouse=True)
def reached_guards(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Fail a test that says which guards it trips, and does not."""
    marks = list(request.node.iter_markers("trips"))
    if not marks:
        yield
        return
    wanted = {name for mark in marks for name in mark.args}
    unknown = wanted - guards().keys()
    assert not unknown, f"there are no such guards: {sorted(unknown)}"
    with watched(monkeypatch) as raised:
        yield
    assert wanted <= raised, f"guards that did not trip: {sorted(wanted - raised)}; those that did: {sorted(raised)}"


def changed(monkeypatch: pytest.MonkeyPatch, target: str, change: Callable[[Any], Any]) -> None:
    """Have a function, ``module:name``, give a wrong result: what a change makes of the right one."""
    module, name = target.split(":")
    owner: Any = sys.modules[f"residua.{module}"]
    *path, last = name.split(".")
    for part in path:
        owner = getattr(owner, part)
    right = getattr(owner, last)
    monkeypatch.setattr(owner, last, lambda *args, **options: change(right(*args, **options)))
