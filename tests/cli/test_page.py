"""The page on the command line names commands and options that exist, and its first example runs."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest

from cli_examples import Residua
from residua.cli.app import COMMANDS, command
from residua.recording.recording import read_recording

PAGE = (Path(__file__).parents[2] / "docs" / "command-line.rst").read_text(encoding="utf-8")
#: From a command, as a term of a list, to the next one; what follows the commands is about those that read recordings.
SECTIONS = re.findall(r"^``residua (\w+)[^`]*``[^\n]*\n((?:(?: .*)?\n)+)", PAGE, flags=re.MULTILINE)
READING = PAGE.rpartition("Recordings\n----------")[2]


def options(name: str) -> set[str]:
    return {flag for one in command(name, []).params for flag in (*one.opts, *one.secondary_opts)} | {"--help"}


def test_the_page_has_every_command() -> None:
    assert {name for name, _ in SECTIONS} == set(COMMANDS)


@pytest.mark.parametrize(("name", "text"), SECTIONS, ids=[name for name, _ in SECTIONS])
def test_the_options_of_a_command_exist(name: str, text: str) -> None:
    assert set(re.findall(r"``(--[a-z-]+)", text)) <= options(name)


def test_the_arguments_of_recordings_exist() -> None:
    named = set(re.findall(r"``--read (\w+)[=`]", READING)) - {"NAME", "help"}
    assert len(named) > 8
    assert named <= set(inspect.signature(read_recording).parameters)
    assert all("--read" in options(name) for name in ("identify", "learn", "fit", "run"))
    assert all("--model" in options(name) for name in ("identify", "learn"))


def test_the_first_example_runs(tmp_path: Path, residua: Residua, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert residua("demo", "three-tank", "-o", ".")[0] == 0
    lines = re.findall(r"^    residua (.*)", PAGE.partition("To try it")[0], flags=re.MULTILINE)
    assert [residua(*line.split())[0] for line in lines] == [0, 0, 0, 1]
    assert (tmp_path / "out-leak.html").exists()
