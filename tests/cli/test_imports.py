"""Modules that commands import: a list of commands needs no numerics, and a run no other command."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from residua.cli.app import COMMANDS, command

SCRIPT = """
import sys
from residua.cli import main
status = main(sys.argv[1:])
print(status, *sorted(sys.modules), sep="\\n", file=sys.stderr)
"""


def imported(*argv: object, status: int = 0) -> set[str]:
    """Return the modules that a command has imported in a process of its own."""
    done = subprocess.run([sys.executable, "-c", SCRIPT, *map(str, argv)], capture_output=True, text=True, check=True)
    first, *names = done.stderr.splitlines()
    assert first == str(status)
    return set(names)


@pytest.mark.parametrize("argv", [("--help",), ("--version",)])
def test_the_list_of_commands_imports_no_numerics(argv: tuple[str, ...]) -> None:
    found = imported(*argv)
    assert not found & {"numpy", "scipy", "rich", "residua.cli.screen"}
    allowed = {"residua", "residua.facade", "residua.errors", "residua.visible", "residua.cli"}
    assert {name for name in found if name.startswith("residua") and name not in allowed} == {
        f"residua.cli.{name}" for name in ("app", "guard", "streams")
    }


def test_a_run_imports_no_other_command(made: Path) -> None:
    found = imported("run", made / "monitor.json", made / "faulty.csv", "-q", status=1)
    assert {name for name in found if name.endswith("_command")} == {"residua.cli.run_command"}
    rooms = (
        "residua.identify",
        "residua.validate",
        "residua.live",
        "residua.library",
        "residua.demos",
        "residua.export",
    )
    assert not [name for name in found if name.startswith(rooms)]
    assert not found & {"residua.design.catalogue", "residua.cli.methods", "scipy.optimize", "scipy.signal"}


@pytest.mark.parametrize("name", COMMANDS)
def test_the_list_and_the_command_have_one_summary(name: str) -> None:
    assert command(name, []).help.split("\n\n")[0] == COMMANDS[name]
