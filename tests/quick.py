"""Style, types and the tests of what changed, within a minute and a half: ``make quick``.

Which tests: of each changed file, the test files that name it, as the syntax trees tell, so that no list has to be
kept. A name counts where it is defined, through however many ``__init__`` files it is passed on. A file that no test
names is tested by those that name the files that import it, and so on outwards until some do; a file that is not
Python, by the files that have its name, or that of its folder, as a string. Tests that changed run first, then the
examples of what changed, then the tests that use the fewest other files. Where no test is near, a fixed core runs.
A verdict of tests is "inconclusive", and the exit status 2, where the time was up before all of them had run.

Changed means: differs from the commit at which this branch left ``main``, committed or not.
"""

from __future__ import annotations

import argparse
import ast
import os
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
SECONDS = 65  # after these no further test begins; on two cores nothing else takes long
MOST = 40  # files whose types are checked besides those that changed
CORE = (
    "tests/test_import.py",
    "tests/test_testing.py",
    "tests/design/test_residual_is_zero.py",
    "tests/design/test_one_theory.py",
    "tests/design/test_observers.py",
    "tests/design/test_suggestion.py",
    "tests/analysis/test_diagnosability.py",
    "tests/decide/test_norm_threshold.py",
    "tests/decide/test_structured.py",
    "tests/linear/test_descriptor.py",
    "tests/linear/test_recursion.py",
    "tests/monitor/test_monitor.py",
    "tests/monitor/test_saving.py",
    "tests/plant/test_plant.py",
    "tests/plant/test_plant_file.py",
    "tests/papers/test_sueur.py",
    "tests/cli/test_statuses.py",
)
CODE = ("src", "tests", "benchmarks", "docs")
UNTIL = "RESIDUA_QUICK_UNTIL"  # seconds since the epoch, for the processes that run the tests
TOO_LATE = "the time of make quick was up"
INCONCLUSIVE = 2  # exit status
_UNFINISHED = 75  # that of pytest where tests were left out and none failed


@dataclass(frozen=True)
class Names:
    """What one file says: the names that it binds by imports, the dotted names that it uses, its strings."""

    bound: dict[str, tuple[str, str]]  # local name -> (module, name in it; empty for the module itself)
    dotted: frozenset[tuple[str, ...]]
    modules: frozenset[str]
    strings: frozenset[str]


def names_of(source: str, package: str) -> Names:
    """Read a file; ``package`` is what relative imports start from."""
    bound: dict[str, tuple[str, str]] = {}
    modules, strings, dotted = set(), set(), set()
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Import(names=aliases):
                for alias in aliases:
                    modules.add(alias.name)
                    bound[alias.asname or alias.name.split(".")[0]] = (
                        (alias.name, "") if alias.asname else (alias.name.split(".")[0], "")
                    )
            case ast.ImportFrom(module=module, names=aliases, level=level):
                above = package.split(".")[: len(package.split(".")) + 1 - level] if level else []
                origin = ".".join([*above, *([module] if module else [])])
                for alias in aliases:
                    bound[alias.asname or alias.name] = (origin, alias.name)
            case ast.Attribute():
                if chain := chain_of(node):
                    dotted.add(chain)
            case ast.Constant(value=str(text)):
                strings.add(text)
    return Names(bound, frozenset(dotted), frozenset(modules), frozenset(strings))


def chain_of(node: ast.expr) -> tuple[str, ...]:
    """Return ``("rs", "design", "kalman_filter")`` for ``rs.design.kalman_filter``; nothing for other expressions."""
    names: list[str] = []
    while isinstance(node, ast.Attribute):
        names.append(node.attr)
        node = node.value
    return (node.id, *reversed(names)) if isinstance(node, ast.Name) else ()


@dataclass(frozen=True)
class Repository:
    """The Python files of a folder and which of them name which."""

    root: Path

    @cached_property
    def python(self) -> tuple[str, ...]:
        """Every Python file under ``src`` and ``tests``."""
        paths = (path for top in ("src", "tests") for path in (self.root / top).rglob("*.py"))
        return tuple(sorted(path.relative_to(self.root).as_posix() for path in paths))

    @cached_property
    def modules(self) -> dict[str, str]:
        """Return the file of every module, extension modules included."""
        compiled = (path.relative_to(self.root).as_posix() for path in (self.root / "src").rglob("*.c"))
        return {module_of(path): path for path in (*compiled, *self.python)}

    @cached_property
    def names(self) -> dict[str, Names]:
        """Return what every file says."""
        result = {}
        for path in self.python:
            module = module_of(path)
            package = module if path.endswith("__init__.py") else module.rpartition(".")[0]
            stub = (self.root / path).with_suffix(".pyi")  # the names that the module of a folder hands on
            text = "\n".join(file.read_text(encoding="utf-8") for file in (self.root / path, stub) if file.exists())
            result[path] = names_of(text, package)
        return result

    def defined(self, module: str, name: str, seen: frozenset[tuple[str, str]] = frozenset()) -> set[str]:
        """Return the files from which a name of a module comes: itself a module, passed on, or defined there."""
        if (file := self.modules.get(f"{module}.{name}")) is not None:
            return {file}
        file = self.modules.get(module)
        if file is None or (module, name) in seen:
            return set()
        if file in self.names and name in self.names[file].bound:
            origin, there = self.names[file].bound[name]
            if origin in self.modules:
                seen = seen | {(module, name)}
                return self.defined(origin, there, seen) if there else {self.modules[origin]}
        return {file}

    @cached_property
    def needs(self) -> dict[str, set[str]]:
        """Return for every file the files whose names it uses."""
        result = {path: set(self._needs_of(names)) - {path} for path, names in self.names.items()}
        for path in result:
            if path.startswith("src/") and not path.endswith("__init__.py"):  # imported by its name when it is called
                result[path] |= {self.modules[text] for text in self.names[path].strings & self.modules.keys()}
        return result

    def _needs_of(self, names: Names) -> Iterator[str]:
        for module in names.modules & self.modules.keys():
            yield self.modules[module]
        for origin, name in names.bound.values():
            if name:
                yield from self.defined(origin, name)
        for first, *rest in names.dotted:
            if first in names.bound:
                origin, name = names.bound[first]
                yield from self._along(f"{origin}.{name}" if name else origin, rest)

    def _along(self, module: str, attributes: list[str]) -> Iterator[str]:
        """Follow attributes from a module: modules first, then the name in the last of them."""
        for attribute in attributes:
            if module not in self.modules:
                return
            if f"{module}.{attribute}" not in self.modules:
                yield from self.defined(module, attribute)
                return
            module = f"{module}.{attribute}"
        if module in self.modules:
            yield self.modules[module]

    @cached_property
    def used_by(self) -> dict[str, set[str]]:
        """Return for every file those that use its names."""
        result: dict[str, set[str]] = {}
        for path, needed in self.needs.items():
            for other in needed:
                result.setdefault(other, set()).add(path)
        return result

    def users(self, path: str) -> set[str]:
        """Return the files one step further out."""
        if Path(path).name == "conftest.py":  # no test names it
            folder = Path(path).parent.as_posix() + "/"
            return {other for other in self.python if other.startswith(folder) and is_test(other)}
        if path.endswith("_command.py"):  # imported by its name when it is called
            path = "src/residua/cli/app.py"
        if path in self.names or path in self.modules.values():
            return self.used_by.get(path, set())
        called = {file for file, names in self.names.items() if Path(path).name in names.strings}
        folders = set(Path(path).parts[:-1]) - {"src", "residua", "tests"}
        return called or {file for file, names in self.names.items() if is_test(file) and folders & names.strings}

    def tests_of(self, path: str) -> set[str]:
        """Return the test files nearest to a file."""
        # A facade passes names on, and whoever uses them there is counted already; only what it uses itself leads on.
        return {path} if is_test(path) else self._outwards(path, through=False) or self._outwards(path, through=True)

    def _outwards(self, path: str, through: bool) -> set[str]:
        """Return the test files that are reached first, by way of facades or not."""
        seen, layer = {path}, {path}
        while layer:
            layer = {user for near in layer for user in self.users(near)} - seen
            if tests := {user for user in layer if is_test(user)}:
                return tests
            seen |= layer
            layer = {user for user in layer if through or not user.endswith("__init__.py")}
        return set()


def module_of(path: str) -> str:
    """Return the name under which a file is imported."""
    _, *folders, last = Path(path).with_suffix("").parts
    return ".".join(folders if last == "__init__" else [*folders, last])


def is_test(path: str) -> bool:
    """Return whether pytest collects tests from a file by its name."""
    return path.startswith("tests/") and Path(path).name.startswith("test_") and path.endswith(".py")


@dataclass(frozen=True)
class Choice:
    """What is run and why."""

    tests: tuple[str, ...]
    types: tuple[str, ...]
    why: str


def choose(repository: Repository, changed: Iterable[str]) -> Choice:
    """Choose tests, and files for the types: those that changed and those that use them."""
    changed = sorted(path for path in changed if (repository.root / path).is_file())
    sources = {path for path in changed if path.startswith("src/") and path.endswith(".py")}
    types = sources | {user for path in sources for user in repository.users(path) if user.startswith("src/")}
    types = types if len(types) <= len(sources) + MOST else sources
    own = {path for path in changed if is_test(path)}
    nearest = own.union(*(repository.tests_of(path) for path in changed))
    if not nearest:
        return Choice(CORE, tuple(sorted(types)), "no test file is near to them: the core")
    # What changed itself first, with the examples in its docstrings; then the tests that use the fewest other files.
    others = sorted(nearest - own, key=lambda path: (len(repository.needs[path]), path))
    tests = (*sorted(own), *sorted(sources), *others)
    return Choice(tests, tuple(sorted(types)), f"{len(nearest)} test files are nearest to them")


def git(root: Path, *arguments: str) -> str:
    """Return what git prints, nothing where it fails."""
    return subprocess.run(["git", "-C", str(root), *arguments], capture_output=True, text=True, check=False).stdout


def changed_files(root: Path, since: str | None) -> tuple[str, set[str]]:
    """Return the commit compared with and the files that differ from it, those unknown to git included."""
    main = next((name for name in ("origin/main", "main") if git(root, "rev-parse", "--verify", "-q", name)), "HEAD")
    base = git(root, "rev-parse", "--verify", "-q", since).strip() if since else ""
    if since and not base:
        raise SystemExit(f"{since!r} is no commit of this repository")
    base = base or git(root, "merge-base", "HEAD", main).strip() or "HEAD"
    listed = git(root, "diff", "--name-only", "-z", base) + git(root, "ls-files", "-o", "--exclude-standard", "-z")
    return base[:10], set(filter(None, listed.split("\0")))


def run(choice: Choice, root: Path, seconds: float) -> int:
    """Run style, types and tests; return the exit status."""
    begun = time.time()
    paths = [str(root / "src"), str(root / "tests"), *filter(None, [os.environ.get("PYTHONPATH")])]
    # An empty PYTHONDONTWRITEBYTECODE is none: what is compiled is kept, for the next process and the next time.
    settings = {UNTIL: str(begun + seconds), "PYTHONPATH": os.pathsep.join(paths), "PYTHONDONTWRITEBYTECODE": ""}
    environment = os.environ | settings
    python, code = [sys.executable, "-m"], [name for name in CODE if (root / name).is_dir()]

    def call(*command: str) -> int:
        return subprocess.run([*python, *command], cwd=root, env=environment, check=False).returncode

    style = call("ruff", "check", "-q", *code) or call("ruff", "format", "--check", "-q", *code)
    with ThreadPoolExecutor(1) as beside:
        checker = ("pyright", "--pythonpath", sys.executable, *choice.types)
        types = beside.submit(lambda: call(*checker) if choice.types else 0)  # without a name it would check everything
        tests = call("pytest", "-q", "-n", "2", "--maxfail=5", "-p", "quick", "--no-header", *choice.tests)
    outcomes = {"style": style, f"types of {len(choice.types)} files": types.result(), "tests": tests}
    verdicts = {0: "good", _UNFINISHED: "inconclusive"}
    print(", ".join(f"{name}: {verdicts.get(status, 'BAD')}" for name, status in outcomes.items()), end=", ")
    print(f"in {time.time() - begun:.0f} s")
    if any(status not in verdicts for status in outcomes.values()):
        return 1
    return INCONCLUSIVE if tests else 0


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Leave a test out when the time is up; ``make test`` runs it."""
    if time.time() > float(os.environ.get(UNTIL, "inf")):
        pytest.skip(TOO_LATE)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Say how many tests were left out, in the exit status too."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is None or hasattr(session.config, "workerinput"):  # a worker of several
        return
    left = sum(TOO_LATE in str(report.longrepr) for report in reporter.stats.get("skipped", ()))
    if left:
        reporter.write_line(f"\n{left} tests were not begun: {TOO_LATE}; make test runs them")
        session.exitstatus = session.exitstatus or _UNFINISHED


def main() -> None:
    """Choose by what changed, say what was chosen, and run it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--since", help="compare with this commit (default: where this branch left main)")
    parser.add_argument("--show", action="store_true", help="print what would run, and run nothing")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="after these no further test begins")
    options = parser.parse_args()
    base, changed = changed_files(REPOSITORY, options.since)
    choice = choose(Repository(REPOSITORY), changed)
    print(f"{len(changed)} files differ from {base}; {choice.why}", flush=True)
    if options.show:
        print(*choice.tests, sep="\n")
        return
    sys.exit(run(choice, REPOSITORY, options.seconds))


if __name__ == "__main__":
    main()
