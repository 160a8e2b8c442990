"""Public calls, options, attributes and command options that an earlier tree had and this one has not.

Everything that a module offers in ``__all__`` counts, with the parameters of its functions and classes and the public
members of its classes; and every option of every command::

    PYTHONPATH=src python benchmarks/public_calls.py ../before/src
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import json
import os
import pkgutil
import subprocess
import sys
from typing import Any


def offered() -> dict[str, list[str]]:
    """Return public names with their parameters and members, by the name of what holds them."""
    import residua

    found: dict[str, list[str]] = {}
    modules = [name for _, name, _ in pkgutil.walk_packages(residua.__path__, "residua.") if "._" not in name]
    for module_name in ["residua", *modules]:
        try:
            module = importlib.import_module(module_name)
        except ImportError:
            continue  # an extra that is not installed
        for name in getattr(module, "__all__", ()):
            thing = getattr(module, name)
            if not inspect.ismodule(thing):
                found[f"{module_name}.{name}"] = sorted(_parts(thing))
    return found | _commands()


def _parts(thing: Any) -> set[str]:
    """Return the parameters of a call, and the public members of a class with their parameters."""
    parts: set[str] = set()
    if inspect.isclass(thing):
        for name in dir(thing):
            if not name.startswith("_"):
                parts.add(f".{name}")
                member = getattr(thing, name)
                if callable(member):
                    parts |= {f".{name}({option})" for option in _parameters(member)}
        parts |= {f".{name}" for name in getattr(thing, "__dataclass_fields__", ()) if not name.startswith("_")}
    return parts | {f"({option})" for option in _parameters(thing)} if callable(thing) else parts


def _parameters(call: Any) -> list[str]:
    try:
        return [name for name in inspect.signature(call).parameters if name not in ("self", "args", "kwargs")]
    except (TypeError, ValueError):
        return []


def _commands() -> dict[str, list[str]]:
    """Return the options of each command."""
    from typer.main import get_command

    from residua.cli import app

    try:
        commands = {name: app.command(name, []) for name in app.COMMANDS}  # imported when they are called
    except AttributeError:
        commands = get_command(app.app).commands  # pyright: ignore[reportAttributeAccessIssue]  # an earlier tree
    return {
        f"residua {name}": sorted(f" {text}" for part in one.params for text in part.opts if text.startswith("-"))
        for name, one in commands.items()
    }


def main() -> None:
    """Print what is gone."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("before", nargs="?", help="source tree of an earlier package")
    options = parser.parse_args()
    now = offered()
    if options.before is None:
        print(json.dumps(now))
        return
    environment = {**os.environ, "PYTHONPATH": options.before}
    answer = subprocess.run([sys.executable, __file__], env=environment, stdout=subprocess.PIPE, check=True)
    before: dict[str, list[str]] = json.loads(answer.stdout)
    gone = 0
    for name, parts in before.items():
        lost = [name] if name not in now else [name + part for part in parts if part not in now[name]]
        gone += len(lost)
        for one in lost:
            print(one)
    count = [sum(1 + len(parts) for parts in tree.values()) for tree in (before, now)]
    print(f"{gone} of {count[0]} names, parameters and members are gone; there are {count[1]} now")


if __name__ == "__main__":
    main()
