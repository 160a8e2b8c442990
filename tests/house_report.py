"""The figures of the house, from its syntax tree.

``python -m tests.house_report [SRC ...] [--csv FILE]`` prints a table with a column for every source tree (of this one
without any), and writes it as well.
"""

from __future__ import annotations

import argparse
import ast
import csv
import re
import statistics
import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))  # as a module of the folder above, and by pytest

from house_tree import SOURCE, Function, House, Module, body_lines

#: Lines of code below which a module with one importer is a fragment, lines of the longest body of a function (a screen
#: and a half), and lines of a module up to which something may go home into it.
FRAGMENT, SCREEN, LARGEST_MODULE = 60, 90, 700
#: Kinds of tests and isolations, settings and what runs.
JUDGES = frozenset(
    {
        *("NormThreshold", "NormTest", "BankTest", "GroupTest", "PeakThreshold", "Directional", "DirectionTest"),
        *("Structured", "CodeTest", "Matched", "MatchedTest", "MatchedFilters"),
    }
)
#: Where a kind of test or isolation hangs, ``None`` where it is another one.
JUDGE_FIELDS = frozenset({"codes", "direction", "matched", "match", "reading", "judge", "groups", "isolate", "test"})
#: Numbers from 0 to this are tolerances: what is smaller counts as nothing.
TOLERANCE = 1e-3
#: Functions that decide a rank with the singular values as evidence, and those that decide it without.
DECIDED = frozenset({"decide_rank", "range_basis", "null_basis", "left_null_basis"})
UNDECIDED = frozenset({"matrix_rank", "null_space", "orth"})
#: Words that a docstring summary does not begin with.
QUESTIONS = frozenset({"what", "which", "whether", "how", "where", "when"})
#: One kind of test, one method and one command, whose names show how many files a new one touches.
A_TEST, A_METHOD, A_COMMAND = ("PeakThreshold", "peak"), "structured_bank", "suggest"


def single_importers(house: House, largest: int | None = None) -> list[tuple[Module, Module]]:
    """Return the modules that one other imports, with that one; up to so many lines of code only within a room."""
    out = []
    for name, importers in house.importers().items():
        module = house.modules[name]
        if len(importers) != 1 or module.is_facade:
            continue
        (user,) = (house.modules[one] for one in importers)
        if largest is None or (module.code_lines < largest and user.room == module.room):
            out.append((module, user))
    return out


def isinstance_of_judges(module: Module) -> Iterator[int]:
    """Yield the lines that ask which kind of test or isolation something is."""
    for node in module.nodes:
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name)
            and node.func.id in ("isinstance", "issubclass")
        ):
            asked = {n.id for n in ast.walk(node.args[1]) if isinstance(n, ast.Name)}
            asked |= {n.attr for n in ast.walk(node.args[1]) if isinstance(n, ast.Attribute)}
            if asked & JUDGES:
                yield node.lineno


def none_of_judges(module: Module) -> Iterator[int]:
    """Yield the lines that ask by ``None`` whether a test or isolation is of one kind."""
    for node in module.nodes:
        if isinstance(node, ast.Compare) and isinstance(node.ops[0], (ast.Is, ast.IsNot)):
            left, right = node.left, node.comparators[0]
            name = left.attr if isinstance(left, ast.Attribute) else left.id if isinstance(left, ast.Name) else ""
            if isinstance(right, ast.Constant) and right.value is None and name in JUDGE_FIELDS:
                yield node.lineno


def tolerances(module: Module) -> Iterator[float]:
    """Yield the float literals that are tolerances; the default of an option is a setting."""
    settings = {id(value) for value in _defaults(module)}
    for node in module.nodes:
        if id(node) in settings:
            continue
        if isinstance(node, ast.Constant) and isinstance(node.value, float) and 0 < node.value <= TOLERANCE:
            yield node.value


def _defaults(module: Module) -> Iterator[ast.expr | None]:
    """Yield the defaults of parameters that are given by name, and of the fields of public classes."""
    for node in module.nodes:
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) and not node.name.startswith("_"):
            yield from node.args.kw_defaults
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from (part.value for part in node.body if isinstance(part, ast.AnnAssign))


def named_tolerances(module: Module) -> Iterator[tuple[str, float]]:
    """Yield the constants of a module that are a tolerance, or made of one."""
    for node in module.tree.body:
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and node.value is not None:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            value = node.value
            if isinstance(value, ast.Constant) and isinstance(value.value, float) and 0 < value.value <= TOLERANCE:
                yield from ((t.id, value.value) for t in targets if isinstance(t, ast.Name))


def rank_decisions(module: Module) -> Iterator[str]:
    """Yield the functions called that decide a rank, and ``svd`` where its values are held to something."""
    for function in module.functions if "svd" in module.text else ():
        calls = {
            node.func.attr if isinstance(node.func, ast.Attribute) else node.func.id
            for node in ast.walk(function)
            if isinstance(node, ast.Call) and isinstance(node.func, (ast.Attribute, ast.Name))
        }
        if calls & {"svd", "svdvals"} and any(isinstance(node, ast.Compare) for node in ast.walk(function)):
            yield "svd"
    for node in module.nodes:
        if isinstance(node, ast.Call) and isinstance(node.func, (ast.Attribute, ast.Name)):
            name = node.func.attr if isinstance(node.func, ast.Attribute) else node.func.id
            if name in DECIDED | UNDECIDED:
                yield name


def mixins(house: House) -> list[str]:
    """Return the classes that only one other inherits from, and that nobody else names or makes: a class cut in two."""
    out = []
    for (module, name), heirs in house.heirs.items():
        if len(heirs) == 1 and not any(name in m.called for m in house.modules.values()):
            named = {m.name for m in house.modules.values() if name in m.names and not m.is_facade}
            if named <= {module, heirs[0][0]}:
                out.append(f"{module}.{name}")
    return sorted(out)


def offered(house: House) -> list[str]:
    """Return the functions that the facade of the designs offers."""
    return [name for name in house.modules["residua.design"].offered if name[0].islower()]


def methods(house: House) -> list[str]:
    """Return the functions that declare themselves methods; in a house of before that, all that are offered."""
    declared = [
        function.name
        for module in house.modules.values()
        for function in module.functions
        for mark in function.decorator_list
        if isinstance(mark, ast.Call) and isinstance(mark.func, ast.Name) and mark.func.id == "method"
    ]
    return declared or offered(house)


def files_naming(house: House, *names: str) -> list[Module]:
    """Return the modules that name one of these, as a name or as a text of their own."""
    out = []
    for module in house.modules.values():
        if set(names) & (module.names | module.texts):
            out.append(module)
    return out


def private_helpers(house: House) -> tuple[int, int]:
    """Return the number of private functions and methods that their module names once, and of all."""
    uses = [m.uses[f.name] for m in house.modules.values() for f in m.functions if _is_private(f.name)]
    return uses.count(1), len(uses)


def unused_options(house: House) -> list[str]:
    """Return the optional parameters that no call of the package passes, of functions that only the package calls."""
    modules = list(house.modules.values())
    calls: dict[str, list[ast.Call]] = defaultdict(list)
    for module in modules:
        for node in module.nodes:
            if isinstance(node, ast.Call):
                calls[getattr(node.func, "id", getattr(node.func, "attr", ""))].append(node)
    uses = sum((m.uses for m in modules), Counter())
    defined = Counter(f.name for m in modules for f in m.functions)
    offered_names = {name for m in modules for name in m.offered}
    out = []
    for module in modules:
        public = {id(f) for c in module.classes if c.name in offered_names for f in ast.walk(c)}
        for function in module.functions:
            name, found = function.name, calls[function.name]
            if defined[name] > 1 or uses[name] != len(found) or not found:
                continue  # a function that is handed on is called where nobody sees it
            if name in offered_names or (id(function) in public and not name.startswith("_")):
                continue
            passed = {option for option in _options(function) if _passed(option, function, found)}
            out += [f"{module.name}.{name}({option})" for option in _options(function) if option not in passed]
    return out


def _options(function: Function) -> list[str]:
    names = [arg.arg for arg in (*function.args.posonlyargs, *function.args.args)]
    pairs = zip(function.args.kwonlyargs, function.args.kw_defaults, strict=True)
    return names[len(names) - len(function.args.defaults) :] + [arg.arg for arg, value in pairs if value is not None]


def _passed(option: str, function: Function, calls: list[ast.Call]) -> bool:
    """Return True if one of the calls may give the option a value."""
    names = [arg.arg for arg in (*function.args.posonlyargs, *function.args.args) if arg.arg not in ("self", "cls")]
    place = names.index(option) if option in names else len(names) + 1000
    return any(
        len(call.args) > place
        or any(isinstance(arg, ast.Starred) for arg in call.args)
        or any(word.arg in (None, option) for word in call.keywords)
        for call in calls
    )


def _is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def figures(house: House) -> dict[str, str]:
    """Return the figures as text, by what they are of; those of rooms and kinds only for this house."""
    modules = list(house.modules.values())
    bodies = sorted(body_lines(f) for m in modules for f in m.functions)
    code = sum(m.code_lines for m in modules)
    summaries = [summary for m in modules for summary in m.summaries]
    once, helpers = private_helpers(house)
    common = {
        "files": str(len(modules)),
        "lines of code": str(code),
        "lines of docstrings": str(sum(m.docstring_lines for m in modules)),
        "comments in 100 lines of code": f"{100 * sum(m.comments for m in modules) / code:.1f}",
        "private helpers with one use": f"{once} of {helpers}",
        "options of inner functions that nobody passes": str(len(unused_options(house))),
        "body of a function: median, 95 %, longest": f"{statistics.median(bodies):g}, "
        f"{bodies[int(0.95 * len(bodies))]}, {bodies[-1]}",
        'docstring summaries with "what"': f"{sum('what' in _words(s) for s in summaries)} of {len(summaries)}",
        "... that begin with what, which, whether, how, where, when": str(
            sum(not QUESTIONS.isdisjoint(_words(summary)[:1]) for summary in summaries)
        ),
        "modules with one importer": str(len(single_importers(house))),
        "imports inside functions": str(sum(one.how == "function" for one in house.imports)),
        "circles of imports at the top": _sizes(house.circles("top")),
    }
    return common | (_of_this_house(house, modules) if house.is_residua else {})


def _words(text: str) -> list[str]:
    return re.findall(r"[a-z]+", text.lower())


def _of_this_house(house: House, modules: list[Module]) -> dict[str, str]:
    """Return the figures of the rules of this house, and the lines of code and files of each room."""
    rooms: dict[str, list[Module]] = defaultdict(list)
    for m in modules:
        rooms[m.room if m.room in {x.name.split(".")[1] for x in modules if x.name.count(".") > 1} else "loose"].append(
            m
        )
    sizes = {
        f"{room}/": f"{sum(m.code_lines for m in inside)} in {len(inside)} files" for room, inside in rooms.items()
    }
    literals = [value for m in modules for value in tolerances(m)]
    named = [pair for m in modules for pair in named_tolerances(m)]
    ranks = [name for m in modules for name in rank_decisions(m)]
    tests = files_naming(house, *A_TEST)
    per_method = [len(files_naming(house, name)) for name in methods(house)]
    return sizes | {
        f"modules with one importer in their room, under {FRAGMENT} lines": str(len(single_importers(house, FRAGMENT))),
        "circles of imports, those for types too": _sizes(house.circles("top", "type")),
        "... without facades": _sizes(_without_facades(house)),
        "isinstance on kinds of judges": _places(modules, isinstance_of_judges),
        "tests by None on kinds of judges": _places(modules, none_of_judges),
        "tolerance literals": f"{len(literals)} in {sum(any(tolerances(m)) for m in modules)} files",
        "... distinct": str(len(set(literals))),
        "named tolerances": str(len(named)),
        "places that decide a rank": str(len(ranks)),
        "... without evidence": str(sum(name not in DECIDED for name in ranks)),
        "classes with one heir that nobody else names": str(len(mixins(house))),
        f"files that name a kind of test ({A_TEST[0]})": f"{len(tests)} in {len({m.room for m in tests})} rooms",
        "files that name a method, median and most": f"{statistics.median(per_method):g}, {max(per_method)}",
        f"... {A_METHOD}": str(len(files_naming(house, A_METHOD, A_METHOD.replace("_", "-")))),
        f"files that name a command ({A_COMMAND})": str(
            sum(m.room == "cli" for m in files_naming(house, A_COMMAND, f"_{A_COMMAND}"))
        ),
    }


def _without_facades(house: House) -> list[list[str]]:
    """Return the circles that stay when no facade hands anything on."""
    handed = {(i.importer, i.target) for i in house.imports if house.modules[i.importer].is_facade}
    return house.circles("top", "type", beside=handed)


def _sizes(circles: list[list[str]]) -> str:
    sizes = sorted(len(circle) for circle in circles)
    span = f"{sizes[0]} to {sizes[-1]}" if len(sizes) > 4 else ", ".join(map(str, sizes))
    return f"{len(sizes)} of {span} modules" if sizes else "0"


def _places(modules: list[Module], find: Callable[[Module], Iterator[object]]) -> str:
    counts = [sum(1 for _ in find(m)) for m in modules]
    return f"{sum(counts)} in {sum(c > 0 for c in counts)} files"


def main(arguments: list[str] | None = None) -> int:
    """Print the table, and write it."""
    parser = argparse.ArgumentParser(prog="house_report", description=__doc__)
    parser.add_argument("sources", type=Path, nargs="*", default=[SOURCE], help="source trees")
    parser.add_argument("--names", nargs="*", help="what the columns are called; the trees when omitted")
    parser.add_argument("--csv", type=Path, help="file to write as well")
    options = parser.parse_args(arguments)
    columns = [figures(House(source)) for source in options.sources]
    names = options.names or [str(source) for source in options.sources]
    keys = list(dict.fromkeys(key for column in columns for key in column))
    lines = [["figure", *names], *([key, *(c.get(key, "") for c in columns)] for key in keys)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    for line in lines:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())
    if options.csv is not None:
        with options.csv.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(lines)
    return 0


if __name__ == "__main__":
    sys.exit(main())
