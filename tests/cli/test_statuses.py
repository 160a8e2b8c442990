"""Exit statuses: 1 is an alarm and nothing else, whatever becomes of the output.

Commands run in forks of one started Python (``forked_process``); for every kind of stream that is closed or full, a
real process runs too, and must do the same.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cli_examples import PLANT, Residua, assert_error, simulate, write_csv
from forked_process import ForkingServer

FULL = Path("/dev/full")
full = pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")
posix = pytest.mark.skipif(os.name != "posix", reason="closes streams by the shell")


Done = subprocess.CompletedProcess[str]
ByShell = Callable[..., Done]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ForkingServer]:
    with ForkingServer(tmp_path_factory.mktemp("streams")) as started:
        yield started


@pytest.fixture
def by_shell(server: ForkingServer) -> ByShell:
    """Run ``residua`` with redirections; where it is asked for, in a process of its own too, with the same outcome."""

    def call(redirections: str, *argv: object, real: bool = False) -> Done:
        forked = server.run(redirections, *argv, environment=os.environ)
        if real:
            done = in_a_process(redirections, *argv)
            assert (forked.returncode, forked.stdout, forked.stderr) == (done.returncode, done.stdout, done.stderr)
        return forked

    return call


def in_a_process(redirections: str, *argv: object) -> Done:
    """Run ``residua`` in a process of its own; ``$@`` are the arguments."""
    line = f'exec "$0" -m residua "$@" {redirections}'
    shell = ["/bin/sh", "-c", line, sys.executable, *map(str, argv)]
    return subprocess.run(shell, capture_output=True, text=True, check=False)


def ways(made: Path) -> dict[str, tuple[object, ...]]:
    return {
        "version": ("--version",),
        "help": ("--help",),
        "help of a command": ("run", "--help"),
        "nothing": (),
        "usage": ("run",),
        "unknown": ("nonsense",),
        "error": ("analyze", made / "absent.toml"),
        "analyze": ("analyze", made / "plant.toml"),
        "json": ("analyze", made / "plant.toml", "--json"),
        "alarm": ("run", made / "monitor.json", made / "faulty.csv"),
        "no alarm": ("run", made / "monitor.json", made / "healthy.csv"),
    }


@full
@posix
@pytest.mark.parametrize(
    ("way", "unbuffered"), [*((way, "") for way in ways(Path())), *((way, "1") for way in ("version", "json", "alarm"))]
)
def test_a_full_output_is_an_error(
    way: str, unbuffered: str, made: Path, by_shell: ByShell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    done = by_shell(">/dev/full", *ways(made)[way], real=way == "alarm")
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert "defect" not in done.stderr
    if way not in ("nothing", "usage", "unknown", "error"):
        assert done.stderr.startswith("error: standard output: ")


@full
@posix
@pytest.mark.parametrize(
    ("way", "where"),
    [
        *((way, "2>/dev/full") for way in ways(Path())),
        *((way, "2>&-") for way in ("usage", "error", "alarm", "no alarm")),
    ],
)
def test_errors_that_nobody_can_read_keep_their_status(way: str, where: str, made: Path, by_shell: ByShell) -> None:
    done = by_shell(where, *ways(made)[way], real=way == "error")
    wrong = way in ("nothing", "usage", "unknown", "error")
    assert done.returncode == (2 if wrong else 1 if way == "alarm" else 0)


@posix
@pytest.mark.parametrize("way", ways(Path()))
def test_a_closed_output_is_an_error_in_plain_words(way: str, made: Path, by_shell: ByShell) -> None:
    done = by_shell(">&-", *ways(made)[way], real=way == "json")
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert "unexpected" not in done.stderr


@posix
def test_what_prints_nothing_needs_no_output(made: Path, by_shell: ByShell) -> None:
    for streams in (">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"):
        real = "<&-" in streams
        assert by_shell(streams, "run", made / "monitor.json", made / "faulty.csv", "-q", real=real).returncode == 1
        assert by_shell(streams, "run", made / "monitor.json", made / "healthy.csv", "-q").returncode == 0


@posix
def test_what_is_printed_never_ends_up_in_a_file(made: Path, tmp_path: Path, by_shell: ByShell) -> None:
    """A file that is opened while the output is closed would get its number."""
    out = tmp_path / "alarms.jsonl"
    options = ("run", made / "monitor.json", made / "faulty.csv", "--alarms", out)
    assert in_a_process(">&- 2>&-", *options).returncode == 2
    by_shell("", *options)
    expected = out.read_text()
    by_shell(">&-", *options)
    assert out.read_text() == expected


@posix
def test_a_reader_of_help_that_goes_away() -> None:
    line = '"$0" -m residua --help | :; exit 0'
    done = subprocess.run(["/bin/sh", "-c", line, sys.executable], capture_output=True, text=True, check=False)
    assert done.stderr == ""


def test_a_package_that_is_broken_is_no_alarm() -> None:
    code = "import sys, residua.cli; sys.modules['residua.cli.app'] = None; sys.exit(residua.cli.main(['--version']))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")


def test_the_option_of_the_command_is_named(made: Path, tmp_path: Path, residua: Residua) -> None:
    rows = simulate(100, 4)
    path = tmp_path / "untimed.csv"
    write_csv(path, rows[:, 1:], "pump,level 1,level 2")
    (tmp_path / "plant.toml").write_text(PLANT.replace("dt = 1.0", ""))
    design = ("design", tmp_path / "plant.toml", "-o", tmp_path / "m.json", "--method", "detection-filter")
    assert residua(*design)[0] == 0
    _, _, err = residua("fit", tmp_path / "m.json", path, "-o", tmp_path / "m.json")
    assert "--read dt" in err
    assert "--read time" in err
    assert_error(residua("run", made / "monitor.json", path, "--read", "dt=7"), "--read dt")


ESCAPE = "\x1b]0;owned\x07\x1b[2J"


def test_escapes_in_names_are_shown_and_not_sent(tmp_path: Path, residua: Residua) -> None:
    odd = PLANT.replace('name = "leak"', 'name = "\\u001b[2Jleak"').replace('"two tanks"', '"\\u001b[31mtanks"')
    (tmp_path / "odd.toml").write_text(odd)
    status, out, err = residua("analyze", tmp_path / "odd.toml")
    assert status == 0
    assert "\x1b" not in out + err
    assert "\\x1b[2Jleak" in out


def test_escapes_in_errors_are_shown_and_not_sent(made: Path, tmp_path: Path, residua: Residua) -> None:
    path = tmp_path / "odd.csv"
    path.write_text(f"time,pump,level 1,level 2\n0,1,2,{ESCAPE}\n1,1,2,3\n")
    result = residua("run", made / "monitor.json", path)
    assert_error(result, "\\x1b")
    assert "\x1b" not in result[2]
    path.write_text(f"time,{ESCAPE},level 1\n0,1,2\n1,1,2\n")
    result = residua("run", made / "monitor.json", path)
    assert_error(result, "\\x1b")
    assert "\x1b" not in result[2]
    result = residua("analyze", tmp_path / f"{ESCAPE}.toml")
    assert "\x1b]0" not in result[2]
