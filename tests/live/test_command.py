"""A program for each event: what it gets, and what becomes of one that fails or hangs."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time

import pytest

from receiver import events
from residua.errors import SettingError
from residua.live.delivery import DeliveryError
from residua.live.sinks.command import Command, Settings


def python(code: str, *arguments: str, **settings) -> Command:
    return Command(Settings((sys.executable, "-c", code, *arguments), **settings))


KEEP = "import sys; open(sys.argv[1], 'a').write(sys.stdin.read())"


def test_the_event_is_its_standard_input(tmp_path):
    sink = python(KEEP, str(tmp_path / "kept; touch x $(touch y)"))  # no shell reads it
    assert sink.deliver(events(3)) == 3
    assert os.listdir(tmp_path) == ["kept; touch x $(touch y)"]
    kept = (tmp_path / "kept; touch x $(touch y)").read_text()
    assert [json.loads(line) for line in kept.splitlines()] == [e.to_dict() for e in events(3)]
    assert sink.name.startswith("command python")


def test_a_failure_keeps_the_event_and_those_after_it(tmp_path):
    code = "import json; n = json.load(sys.stdin)['number']; sys.exit(3 * (n == 2))".replace(
        "import json", "import json, sys"
    )
    sink = python(code)
    assert sink.deliver(events(3)) == 1
    with pytest.raises(DeliveryError, match="ended with status 3"):
        sink.deliver(events(3)[1:])


def test_a_program_that_reads_nothing_is_content():
    assert python("").deliver(events(2)) == 2


def test_refused_events_are_given_up_where_that_is_asked_for():
    with pytest.raises(DeliveryError, match=r"refuses the event \(status 65\); drop_refused"):
        python("raise SystemExit(65)").deliver(events(1))
    sink = python("raise SystemExit(65)", drop_refused=True)
    assert sink.deliver(events(2)) == 2
    assert sink.dropped == 2


@pytest.mark.skipif(shutil.which("ps") is None, reason="no ps, which lists processes, on this machine")
def test_one_that_hangs_is_ended_with_its_children(tmp_path):
    code = (
        "import subprocess, sys, time;"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)']);"
        "open(sys.argv[1], 'w').write(str(child.pid)); time.sleep(60)"
    )
    begun = time.monotonic()
    with pytest.raises(DeliveryError, match=r"took more than 1\.5 s and was ended"):
        python(code, str(tmp_path / "pid"), timeout=1.5).deliver(events(1))
    assert time.monotonic() - begun < 10
    child = int((tmp_path / "pid").read_text())
    for _ in range(100):
        if not _runs(child):
            break
        time.sleep(0.05)
    assert not _runs(child)


def _runs(process: int) -> bool:
    """Whether a process is there and not only waited for."""
    done = subprocess.run(["ps", "-o", "stat=", "-p", str(process)], capture_output=True, text=True, check=False)
    return done.stdout.strip()[:1] not in ("", "Z")


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_one_that_dies_by_a_signal():
    with pytest.raises(DeliveryError, match="ended by signal 9"):
        python("import os; os.kill(os.getpid(), 9)").deliver(events(1))


def test_its_output_does_not_mix_with_the_runs(capfd):
    python("print('from the program')").deliver(events(1))
    out, err = capfd.readouterr()
    assert out == ""
    assert "from the program" in err


def test_a_program_that_is_not_there():
    with pytest.raises(SettingError, match="there is no program 'no-such-program'"):
        Command(Settings(("no-such-program",)))
