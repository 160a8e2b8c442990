"""Events in a file: whole lines whatever happens while they are written."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import time

import pytest

from receiver import events
from residua.errors import SettingError
from residua.live.delivery import DeliveryError
from residua.live.sinks.jsonl import BATCH, LOOKED_AT, JsonLines, Settings


@pytest.fixture
def path(tmp_path):
    return tmp_path / "events.jsonl"


def lines(path) -> list[dict]:
    text = path.read_text()
    assert not text or text.endswith("\n")
    return [json.loads(line) for line in text.splitlines()]


def test_one_line_for_each_event_after_what_was_there(path):
    sink = JsonLines(Settings(str(path)))
    assert sink.name == f"jsonl {path}"
    assert sink.deliver(events(2)) == 2
    assert JsonLines(Settings(str(path))).deliver(events(4)[2:]) == 2
    assert lines(path) == [e.to_dict() for e in events(4)]


TORN = [events(3)[2].to_json().encode()[:kept] for kept in (0, 1, 5, 10, 11, 30, -1)]
#: A file may have grown by what was not written to the disk yet, a part of a later line among it.
ZEROS = [
    before + bytes(4096) + b'th", "number": 9}\n' for before in (b"", b'{"plant": "no', b'{"plant": "north"}\n{"pla')
]


@pytest.mark.parametrize("end", [*TORN, *ZEROS])
def test_what_a_kill_or_a_loss_of_power_leaves_at_the_end_is_taken_away(path, end):
    """Wherever a line was torn; the event was not said to be delivered, and comes again."""
    JsonLines(Settings(str(path))).deliver(events(2))
    with path.open("ab") as file:
        file.write(end)
    JsonLines(Settings(str(path))).deliver(events(3)[2:])
    assert [one for one in lines(path) if "number" in one] == [e.to_dict() for e in events(3)]


def test_a_whole_line_without_its_end_stays(path):
    """Such as an editor leaves."""
    path.write_text('{"plant": "north", "number": 0}')
    JsonLines(Settings(str(path))).deliver(events(1))
    assert [one["number"] for one in lines(path)] == [0, 1]


@pytest.mark.parametrize(
    "content",
    [b"Dear diary", b"line\nlast, not ended", b"\xff\xfe\x00\x01", b'{"plant": "' + b"x" * (LOOKED_AT + 10)],
    ids=len,
)
def test_a_file_of_something_else_is_left_alone(path, content):
    path.write_bytes(content)
    with pytest.raises(DeliveryError, match="left alone"):
        JsonLines(Settings(str(path))).deliver(events(1))
    assert path.read_bytes() == content


def test_a_large_backlog_goes_in_pieces(path):
    many = events(5000)
    sink, done = JsonLines(Settings(str(path))), 0
    while done < len(many):
        count = sink.deliver(many[done:])
        assert 0 < count < 5000
        assert sum(len(e.to_json()) + 1 for e in many[done : done + count - 1]) < BATCH
        done += count
    assert lines(path) == [e.to_dict() for e in many]


def test_a_file_that_is_renamed_makes_room_for_another(path):
    sink = JsonLines(Settings(str(path)))
    sink.deliver(events(1))
    path.rename(path.with_suffix(".old"))
    sink.deliver(events(2)[1:])
    assert [one["number"] for one in lines(path)] == [2]


@pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
def test_two_processes_do_not_write_one_file(path):
    import fcntl

    sink = JsonLines(Settings(str(path)))
    sink.deliver(events(1))
    with path.open("ab") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(DeliveryError, match="another process is writing"):
            sink.deliver(events(1))
    assert sink.deliver(events(1)) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="limits of POSIX")
def test_a_full_disk_leaves_whole_lines(path):
    """A limit on the size of files stands for it: writing stops in the middle of a line."""
    code = (
        "import resource, signal, sys; sys.path[:0] = sys.argv[3:];"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN); resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000));"
        "from receiver import events; from residua.live.sinks.jsonl import JsonLines, Settings\n"
        "from residua.live.delivery import DeliveryError\n"
        "sink = JsonLines(Settings(sys.argv[1])); sink.deliver(events(3))\n"
        "try: sink.deliver(events(30)[3:])\n"
        "except DeliveryError as error: print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(path), "", *sys.path], capture_output=True, text=True, check=True
    )
    assert "cannot be written" in done.stdout
    assert lines(path) == [e.to_dict() for e in events(3)]


def test_a_folder_that_goes_away_is_said(tmp_path):
    folder = tmp_path / "logs"
    folder.mkdir()
    sink = JsonLines(Settings(str(folder / "events.jsonl")))
    folder.rmdir()
    with pytest.raises(DeliveryError, match="cannot be written: No such file"):
        sink.deliver(events(1))


WRITE = """
import sys; sys.path[:0] = sys.argv[3:]
from receiver import events
from residua.live.sinks.jsonl import JsonLines, Settings
sink, at = JsonLines(Settings(sys.argv[1])), int(sys.argv[2])
many = events(at + 20_000)
print("on", flush=True)
while at < len(many):
    at += sink.deliver(many[at:at + 50])
    print(at, flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL")
def test_killed_at_any_moment_no_line_is_torn_and_none_is_lost(path):
    rng, delivered = random.Random(5), 0
    for _ in range(4):
        process = subprocess.Popen(
            [sys.executable, "-c", WRITE, str(path), str(delivered), *sys.path], stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        assert process.stdout.readline() == "on\n"
        time.sleep(0.02 + 0.1 * rng.random())
        process.kill()
        told = process.stdout.read().split("\n")
        process.wait()
        process.stdout.close()
        delivered = max([delivered, *(int(one) for one in told[:-1])])
    JsonLines(Settings(str(path))).deliver(events(delivered + 1)[delivered:])
    numbers = [one["number"] for one in lines(path)]
    assert delivered > 100
    assert set(range(1, delivered + 2)) <= set(numbers)
    firsts = list(dict.fromkeys(numbers))
    assert firsts == sorted(firsts)  # repeats left out, the order is that of the events


@pytest.mark.parametrize(
    ("name", "said"), [("", "must be named"), ("none/events.jsonl", "does not exist"), (".", "is not a file")]
)
def test_settings_that_make_no_sense(tmp_path, name, said):
    with pytest.raises(SettingError, match=said):
        Settings(str(tmp_path / name) if name else "")
