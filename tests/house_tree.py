"""The source as its syntax tree tells it: modules, rooms, imports, functions, classes, numbers."""

from __future__ import annotations

import ast
import io
import tokenize
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

SOURCE = Path(__file__).resolve().parent.parent / "src"

_LAYOUT = {
    *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT),
    *(tokenize.ENDMARKER, tokenize.ENCODING),
}
Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Import:
    """One import of a module of the package: who, whom, where, and how.

    Attributes
    ----------
    importer, target : str
        Modules.
    line : int
    how : {"top", "type", "function"}
        At the top, for types alone, or inside a function.
    """

    importer: str
    target: str
    line: int
    how: str


@dataclass(frozen=True, eq=False)
class Module:
    """A module of the package."""

    name: str
    path: Path
    text: str

    @cached_property
    def tree(self) -> ast.Module:
        """Its syntax tree; of the module of a folder, with the imports of its stub as those for types."""
        tree = ast.parse(self.text)
        stub = self.path.with_suffix(".pyi")
        if stub.exists():
            block = "\n    ".join(["if TYPE_CHECKING:", *stub.read_text(encoding="utf-8").splitlines()])
            tree.body += ast.parse(block).body
        return tree

    @cached_property
    def nodes(self) -> list[ast.AST]:
        """All nodes of its tree."""
        return list(ast.walk(self.tree))

    @property
    def is_package(self) -> bool:
        """Whether it is the module of a folder."""
        return self.path.name == "__init__.py"

    @property
    def is_facade(self) -> bool:
        """Whether it is the module of a folder that only hands on names."""
        return self.is_package and all(f.name.startswith("__") for f in self.functions)

    @property
    def room(self) -> str:
        """The folder below the package, or the module itself where it lies loose."""
        parts = self.name.split(".")
        return parts[1] if len(parts) > 1 else parts[0]

    @cached_property
    def docstring_lines(self) -> int:
        """Lines of docstrings."""
        return len(_docstring_lines(self.nodes))

    @cached_property
    def code_lines(self) -> int:
        """Lines of code: without docstrings, comments and blank lines."""
        lines: set[int] = set()
        for token in tokenize.generate_tokens(io.StringIO(self.text).readline):
            if token.type not in _LAYOUT:
                lines |= set(range(token.start[0], token.end[0] + 1))
        return len(lines - _docstring_lines(self.nodes))

    @cached_property
    def comments(self) -> int:
        """Lines that hold a comment."""
        tokens = tokenize.generate_tokens(io.StringIO(self.text).readline)
        return sum(token.type == tokenize.COMMENT for token in tokens)

    @cached_property
    def summaries(self) -> list[str]:
        """First paragraphs of its docstrings."""
        documented = (n for n in self.nodes if isinstance(n, ast.Module | ast.ClassDef | Function))
        texts = (ast.get_docstring(node) for node in documented)
        return [text.split("\n\n")[0].replace("\n", " ") for text in texts if text]

    @cached_property
    def offered(self) -> list[str]:
        """Texts in its ``__all__``, or the names that its stub imports."""
        if self.path.with_suffix(".pyi").exists():
            return [alias.name for node in self.nodes if isinstance(node, ast.ImportFrom) for alias in node.names]
        for node in self.tree.body:
            if isinstance(node, ast.Assign) and "__all__" in [getattr(t, "id", "") for t in node.targets]:
                texts = (n.value for n in ast.walk(node.value) if isinstance(n, ast.Constant))
                return [text for text in texts if isinstance(text, str)]
        return []

    @cached_property
    def uses(self) -> Counter[str]:
        """How often it reads each name or attribute, or imports it from another module."""
        found = Counter(node.id for node in self.nodes if isinstance(node, ast.Name))
        found.update(node.attr for node in self.nodes if isinstance(node, ast.Attribute))
        return found

    @cached_property
    def names(self) -> frozenset[str]:
        """Every name and attribute in it."""
        found = {node.id for node in self.nodes if isinstance(node, ast.Name)}
        found |= {node.attr for node in self.nodes if isinstance(node, ast.Attribute)}
        found |= {a.name for node in self.nodes if isinstance(node, ast.ImportFrom) for a in node.names}
        return frozenset(found | {f.name for f in self.functions} | {c.name for c in self.classes})

    @cached_property
    def called(self) -> frozenset[str]:
        """The names that it calls."""
        calls = (node.func for node in self.nodes if isinstance(node, ast.Call))
        return frozenset(func.id for func in calls if isinstance(func, ast.Name))

    @cached_property
    def texts(self) -> frozenset[str]:
        """The texts in it."""
        constants = (node.value for node in self.nodes if isinstance(node, ast.Constant))
        return frozenset(value for value in constants if isinstance(value, str))

    @cached_property
    def functions(self) -> list[Function]:
        """Its functions and methods, nested ones too."""
        return [node for node in self.nodes if isinstance(node, Function)]

    @cached_property
    def classes(self) -> list[ast.ClassDef]:
        """Its classes."""
        return [node for node in self.nodes if isinstance(node, ast.ClassDef)]


def _docstring_lines(nodes: list[ast.AST]) -> set[int]:
    lines: set[int] = set()
    for node in nodes:
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            first = node.body[0] if node.body else None
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                lines |= set(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    return lines


def body_lines(function: Function) -> int:
    """Return the lines of the body of a function, from the first statement after its docstring to the last."""
    body = function.body
    first = body[0]
    if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str):
        body = body[1:]
    return (body[-1].end_lineno or body[-1].lineno) - body[0].lineno + 1 if body else 0


class House:
    """The modules of a source tree, and what leads from one to the other."""

    def __init__(self, source: Path = SOURCE) -> None:
        root = source / "residua" if (source / "residua").is_dir() else source
        self.is_residua = (root / "design").is_dir() and (root / "decide").is_dir()
        self.modules: dict[str, Module] = {}
        for path in sorted(root.rglob("*.py")):
            if "tests" in path.parts[len(root.parts) :]:
                continue  # other packages keep their tests inside
            parts = ["residua" if self.is_residua else root.name, *path.relative_to(root).with_suffix("").parts]
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            self.modules[name] = Module(name, path, path.read_text(encoding="utf-8"))

    @cached_property
    def imports(self) -> list[Import]:
        """Every import of a module of the package within it."""
        return [found for module in self.modules.values() for found in self._imports_of(module)]

    def _imports_of(self, module: Module) -> Iterator[Import]:
        for node, how in _placed(module.tree, "top"):
            for target in self._targets(module, node):
                if target in self.modules:
                    yield Import(module.name, target, node.lineno, how)

    def _targets(self, module: Module, node: ast.Import | ast.ImportFrom) -> set[str]:
        """Return the modules that an import names."""
        if isinstance(node, ast.Import):
            return {alias.name for alias in node.names}
        base = node.module or ""
        if node.level:
            parts = module.name.split(".")
            kept = parts[: len(parts) - node.level + module.is_package]
            base = ".".join([*kept, *([node.module] if node.module else [])])
        names = {f"{base}.{alias.name}" for alias in node.names}
        inner = names & self.modules.keys()
        return inner | ({base} if len(inner) < len(names) else set())

    def importers(self, *, facades: bool = False) -> dict[str, set[str]]:
        """Return who imports each module; facades, which only hand on names, are left out unless asked for."""
        found: dict[str, set[str]] = {name: set() for name in self.modules}
        for one in self.imports:
            if one.importer != one.target and (facades or not self.modules[one.importer].is_facade):
                found[one.target].add(one.importer)
        return found

    def circles(self, *how: str, beside: Collection[tuple[str, str]] = ()) -> list[list[str]]:
        """Return the sets of modules that reach each other by imports of these kinds, but for some pairs of modules."""
        graph: dict[str, set[str]] = defaultdict(set)
        for one in self.imports:
            if one.how in how and (one.importer, one.target) not in beside:
                graph[one.importer].add(one.target)
        return [
            sorted(part)
            for part in _components(graph, sorted(self.modules))
            if len(part) > 1 or part & graph[min(part)]
        ]

    @cached_property
    def heirs(self) -> dict[tuple[str, str], list[tuple[str, str]]]:
        """Classes of the package, as (module, name), that others of it inherit from, with those."""
        found: dict[tuple[str, str], list[tuple[str, str]]] = defaultdict(list)
        defined = {(m.name, c.name) for m in self.modules.values() for c in m.classes}
        for module in self.modules.values():
            origin = {
                alias.asname or alias.name: (target, alias.name)
                for node, _ in _placed(module.tree, "top")
                if isinstance(node, ast.ImportFrom)
                for target in self._targets(module, node)
                for alias in node.names
            }
            for made in module.classes:
                for base in made.bases:
                    name = base.id if isinstance(base, ast.Name) else ""
                    whose = origin.get(name, (module.name, name))
                    if whose in defined:
                        found[whose].append((module.name, made.name))
        return dict(found)


def _placed(node: ast.AST, how: str) -> Iterator[tuple[ast.Import | ast.ImportFrom, str]]:
    """Yield imports with where they stand."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.expr):
            continue  # nothing is imported in there
        if isinstance(child, (ast.Import, ast.ImportFrom)):
            yield child, how
        elif isinstance(child, Function):
            yield from _placed(child, "function")
        elif isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test):
            yield from _placed(child, "type" if how == "top" else how)
        else:
            yield from _placed(child, how)


def _components(graph: dict[str, set[str]], nodes: list[str]) -> list[set[str]]:
    """Return the strongly connected components of a graph (Tarjan)."""
    number: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    out: list[set[str]] = []

    def visit(node: str) -> None:
        number[node] = low[node] = len(number)
        stack.append(node)
        for other in sorted(graph.get(node, ())):
            if other not in number:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], number[other])
        if low[node] == number[node]:
            part = set()
            while node not in part:
                part.add(stack.pop())
            out.append(part)

    for node in nodes:
        if node not in number:
            visit(node)
    return out
