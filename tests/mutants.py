"""Guards that are made wrong on purpose: the tests that say they trip them must turn red.

``python tests/mutants.py`` (``make mutants``) changes the condition of each guard of ``design/`` and ``linear/``, one
change at a time, with the operators of Cosmic Ray: comparisons turned round, ``and`` for ``or``, ``not`` added and left
out, other numbers; and switches the guard off. For each change the tests that trip the guard run in a process of their
own, in which the changed module is imported: no file is written. What stays green is listed: a hole in the tests.

``--off`` only switches guards off, which takes no package; guards may be named.
"""

from __future__ import annotations

import argparse
import ast
import importlib.machinery
import os
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import CodeType
from typing import Any

import numpy  # noqa: F401 - before the processes part, so that it is read once
import pytest
import scipy.linalg
import scipy.optimize  # noqa: F401

TESTS = Path(__file__).resolve().parent
#: Seconds that a test of a guard may take; a change that makes it hang is noticed too.
PATIENCE = 120
#: Operators that say the same of numbers that are not equal, or that types rule out.
SAME = {"Lt_LtE", "LtE_Lt", "Gt_GtE", "GtE_Gt", "Eq_Is", "NotEq_IsNot"}
CHANGES = (
    "ReplaceComparisonOperator",
    "ReplaceAndWithOr",
    "ReplaceOrWithAnd",
    "AddNot",
    "NumberReplacer",
    "Delete_Not",
)


@dataclass(frozen=True)
class Mutant:
    """A guard, what is changed, the file and its changed text."""

    guard: str
    change: str
    path: str
    text: str


def condition(tree: ast.AST, line: int) -> ast.expr | None:
    """Return the condition of the innermost ``if`` whose body has a statement that begins on a line."""
    found = None
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and any(one.lineno == line for one in node.body):
            found = node.test
    return found


def switched_off(guard: str, path: str, first: int, last: int) -> Mutant | None:
    """Return a guard whose condition never holds, or that does nothing where it has none; ``None`` for a result."""
    text = Path(path).read_text()
    test = condition(ast.parse(text), first)
    lines = text.splitlines(keepends=True)
    if test is None:
        if not lines[first - 1].lstrip().startswith("raise"):
            return None
        start = len(lines[first - 1]) - len(lines[first - 1].lstrip())
        lines[first - 1 : last] = [" " * start + "pass\n"]
    else:
        begin, end = test.lineno - 1, (test.end_lineno or test.lineno) - 1
        head = lines[begin].encode()[: test.col_offset].decode()
        tail = lines[end].encode()[test.end_col_offset :].decode()
        lines[begin : end + 1] = [f"{head}False{tail}"]
    return Mutant(guard, "switched off", path, "".join(lines))


def mutated(guard: str, path: str, first: int) -> Iterator[Mutant]:
    """Yield the changes that Cosmic Ray's operators make of the condition of a guard."""
    import parso
    from cosmic_ray.ast import ast_nodes
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator, operator_names

    text = Path(path).read_text()
    test = condition(ast.parse(text), first)
    if test is None:
        return
    begin, end = (test.lineno, test.col_offset), (test.end_lineno, test.end_col_offset)
    nodes = list(ast_nodes(parso.parse(text)))
    for name in operator_names():
        kind = name.removeprefix("core/")
        if not any(one in kind for one in CHANGES) or any(kind.endswith(one) for one in SAME) or "Is" in kind:
            continue
        operator = get_operator(name)()
        places = [place for node in nodes for place in operator.mutation_positions(node)]
        for occurrence, (start, _) in enumerate(places):
            if begin <= start < end or (kind == "AddNot" and start[0] == begin[0]):
                changed = mutate_code(text, operator, occurrence)
                if changed is not None and changed != text:
                    yield Mutant(guard, f"{kind} at {start[0]}:{start[1]}", path, changed)


def survives(mutant: Mutant, files: list[str]) -> bool:
    """Tell whether the tests of a guard stay green with it changed, in a process of its own."""
    child = os.fork()
    if not child:
        os._exit(_run(mutant, files))
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            if os.waitstatus_to_exitcode(status) == pytest.ExitCode.NO_TESTS_COLLECTED:
                raise LookupError(f"no test trips {mutant.guard}")
            return status == 0
        time.sleep(0.01)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return False


def _run(mutant: Mutant, files: list[str]) -> int:
    """Run the tests of a guard with its module changed, and in silence."""
    right = importlib.machinery.SourceFileLoader.get_code

    def get_code(self: Any, fullname: str) -> CodeType | None:
        return compile(mutant.text, self.path, "exec") if self.path == mutant.path else right(self, fullname)

    importlib.machinery.SourceFileLoader.get_code = get_code
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)
    paths = [str(TESTS.parent / one) for one in files]
    return int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", *paths], plugins=[_Only(mutant.guard)]))


class _Only:
    """Runs the tests alone that trip a guard."""

    def __init__(self, guard: str) -> None:
        self.guard = guard

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = [one for one in items if any(self.guard in mark.args for mark in one.iter_markers("trips"))]


def found_guards() -> tuple[dict[str, tuple[str, int, int]], dict[str, list[str]]]:
    """Return guards and the files of their tests, read in a process that imports the package; this one must not."""
    receive, send = os.pipe()
    child = os.fork()
    if not child:
        from guards import claimed, guards

        with os.fdopen(send, "w") as out:
            out.write(repr((guards(), dict(claimed()))))
        os._exit(0)
    os.close(send)
    with os.fdopen(receive) as told:
        text = told.read()
    os.waitpid(child, 0)
    return ast.literal_eval(text)


def main() -> int:
    """Make the mutants and return how many survive."""
    parser = argparse.ArgumentParser(prog="mutants", description=__doc__)
    parser.add_argument(
        "guards", nargs="*", help="guards, as tests/guards.py calls them; those of the folders by default"
    )
    parser.add_argument("--off", action="store_true", help="switch the guards off, and no more")
    parser.add_argument("--in", dest="folders", nargs="+", default=["design", "linear"], help="folders of guards")
    asked = parser.parse_args()
    guards, claimed = found_guards()
    chosen = asked.guards or [name for name in guards if name.split(".")[0] in asked.folders]
    count, left = 0, []
    for name in chosen:
        path, first, last = guards[name]
        off = switched_off(name, path, first, last)
        mutants = [] if off is None else [off]
        mutants += [] if asked.off else mutated(name, path, first)
        files = sorted(set(claimed[name]))
        if name == chosen[0] and not survives(Mutant(name, "unchanged", path, Path(path).read_text()), files):
            raise SystemExit(f"the tests of {name} are red without any change")
        for mutant in mutants:
            count += 1
            if survives(mutant, files):
                left.append(mutant)
                print(f"survives: {name}: {mutant.change}", flush=True)
    print(f"{count} mutants of {len(chosen)} guards, {len(left)} survive")
    return len(left)


if __name__ == "__main__":
    sys.path[:0] = [str(TESTS), str(TESTS.parent / "src")]
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(min(main(), 100))
