"""The command `residua live`."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

pytest.importorskip("orjson")
pytest.importorskip("uvicorn")

from live_examples import recording
from live_runs import command, configuration, events_in, line

STDIN = '[[sources]]\nkind = "stdin"'


def test_the_example_and_the_check(tmp_path: Path) -> None:
    made = command("--example")
    assert made.returncode == 0
    assert "[[monitors]]" in made.stdout
    checked = command(configuration(tmp_path, STDIN), "--check")
    assert checked.returncode == 0, checked.stderr
    assert checked.stdout.splitlines() == [
        "monitor tank: 1 plants",
        "source stdin",
        f"store {tmp_path / 'live.db'}",
        "page: none",
    ]
    assert not (tmp_path / "live.db").exists()


@pytest.mark.parametrize("option", [[], ["--check"]], ids=["run", "check"])
def test_secrets_are_read_before_anything_is_opened(tmp_path: Path, option: list[str]) -> None:
    sink = '[[sinks]]\nkind = "webhook"\nurl = "http://127.0.0.1:9/"\nkey_env = "RESIDUA_TEST_NO_SUCH_KEY"'
    made = command(configuration(tmp_path, STDIN, sink), *option)
    assert made.returncode == 2
    said = "sink webhook: key_env: the environment variable RESIDUA_TEST_NO_SUCH_KEY is not set"
    assert made.stderr == f"error: {said}\n"
    assert not (tmp_path / "live.db").exists()


def test_what_is_wrong_is_one_line_and_status_2(tmp_path: Path) -> None:
    path = configuration(tmp_path, STDIN, more="colour = 3")
    made = command(path)
    assert made.returncode == 2
    assert made.stderr == f"error: {path}, line 4: monitors.colour: unknown\n"
    none = command()
    assert none.returncode == 2
    assert "--example" in none.stderr


def test_ctrl_c_ends_it_in_order_and_the_next_run_goes_on(tmp_path: Path) -> None:
    rows, path = recording(2000), configuration(tmp_path, STDIN)
    lines = [line("north", float(k), row) for k, row in enumerate(rows)]
    program = [sys.executable, "-m", "residua", "live", str(path)]
    run = subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert run.stdin is not None
    assert run.stdout is not None
    assert "watching 1 plants" in run.stdout.readline()
    run.stdin.write("\n".join(lines[:1000]) + "\n")
    run.stdin.flush()
    second = command(path)
    assert second.returncode == 2
    assert "another run uses this store" in second.stderr
    time.sleep(1.0)
    run.send_signal(signal.SIGINT)
    output, errors = run.communicate(timeout=60)
    assert run.returncode == 0, errors
    assert "1,000 rows, 1 alarms raised" in output
    rest = command(path, input="\n".join(lines))  # from the beginning: what the store has is dropped
    assert "1,000 rows" in rest.stdout, rest.stdout + rest.stderr
    assert "repeat" in rest.stderr
    events = events_in(tmp_path / "live.db")
    assert [one["number"] for one in events] == list(range(1, len(events) + 1))


def test_reset_lets_a_plant_begin_anew(tmp_path: Path) -> None:
    rows, path = recording(2000), configuration(tmp_path, STDIN)
    made = command(path, input="\n".join(line("north", 1000.0 + k, row) for k, row in enumerate(rows[:200])))
    assert made.returncode == 0, made.stderr
    back = [line("north", float(k), row) for k, row in enumerate(rows[:200])]
    refused = command(path, input="\n".join(back))
    assert refused.returncode == 2
    assert "no sample could be judged" in refused.stderr
    assert "not used: refused 190, late 10" in refused.stdout
    assert [one["kind"] for one in events_in(tmp_path / "live.db")] == ["clock"]
    assert command(path, "--reset", "nobody").stderr == "error: the store has no plant 'nobody'\n"
    asked = command(path, "--reset", "north")
    assert asked.returncode == 0, asked.stderr
    again = command(path, input="\n".join(back))
    assert "200 rows" in again.stdout, again.stdout + again.stderr


def test_the_demo_names_a_fault_on_its_page(tmp_path: Path) -> None:
    begin = time.monotonic()
    program = [sys.executable, "-m", "residua", "live", "--demo", "-o", str(tmp_path)]
    run = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert run.stdout is not None
        address = next(one.split()[1] for one in run.stdout if one.startswith("page: "))
        base, _, token = address.partition("?token=")
        request = urllib.request.Request(f"{base}overview.json", headers={"Authorization": f"Bearer {token}"})
        named = ""
        while named != "leak 3" and time.monotonic() - begin < 60:
            time.sleep(0.5)
            with urllib.request.urlopen(request, timeout=10) as answer:
                rows = json.load(answer)["rows"]
            named = next(row["name"] for row in rows if row["plant"] == "south")
    finally:
        run.terminate()
        run.communicate(timeout=60)
    assert named == "leak 3"
