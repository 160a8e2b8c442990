"""Lines of JSON from files, pipes and standard input."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import tracemalloc
from pathlib import Path

import pytest

from live.brokers import Run, wait_for
from residua.errors import SettingError
from residua.live.source import LARGEST
from residua.live.sources.stdin import JsonLines, Settings, split


def lines(count: int) -> list[bytes]:
    return [json.dumps({"plant": "north", "t": float(k), "y": [k / 3]}).encode() for k in range(count)]


def test_every_line_of_a_file_comes_once_in_order(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_bytes(b"\n".join(lines(5000)))
    source = JsonLines(Settings(str(path), plant="north"))
    with Run(source, most=50) as run:
        wait_for(lambda: source.over)
        run.wait_for(5000)
    assert [m.payload for m in run.messages] == lines(5000)
    assert {(m.plant, m.channel, m.refused) for m in run.messages} == {("north", "", "")}
    assert source.finite
    assert source.health.good
    assert "5,000 lines" in source.health.text


def test_a_line_without_end_is_refused_and_not_held(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    with path.open("wb") as file:
        file.write(b'{"t": 1}\n')
        for _ in range(50):
            file.write(b"x" * 1_000_000)
        file.write(b'\n\n{"t": 2}\n' + b"y" * (LARGEST + 1) + b"\n" + b"z" * (LARGEST + 1))
    tracemalloc.start()
    try:
        with Run(JsonLines(Settings(str(path)))) as run:
            run.wait_for(5)
        assert tracemalloc.get_traced_memory()[1] < 4 * LARGEST  # of 58 MB
    finally:
        tracemalloc.stop()
    assert [(m.payload, m.refused) for m in run.messages] == [
        (b'{"t": 1}', ""), (b"", "size"), (b'{"t": 2}', ""), (b"", "size"), (b"", "size"),
    ]  # fmt: skip


@pytest.mark.parametrize("size", [1, 2, 3, 7, 1000])
def test_lines_do_not_depend_on_the_pieces_that_they_come_in(size: int) -> None:
    text = b"a\n\nbcd\n" + b"e" * 11 + b"\nf" * 3 + b"\n" + b"g" * 30
    pieces = (text[k : k + size] for k in range(0, len(text), size))
    assert list(split(pieces, most=10)) == [b"a", b"", b"bcd", None, b"f", b"f", b"f", None]


def test_a_named_pipe_waits_for_its_writer_and_ends_with_it(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    source = JsonLines(Settings(str(path)))
    with Run(source) as run:
        assert not source.over

        def write() -> None:
            with path.open("wb") as file:
                file.write(b"\n".join(lines(100)) + b"\n")

        writer = threading.Thread(target=write)
        writer.start()
        writer.join()
        run.wait_for(100)
        wait_for(lambda: source.over)


def test_a_pipe_that_nobody_writes_to_is_left_at_once(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    source = JsonLines(Settings(str(path), follow=True))
    with Run(source):
        assert not source.finite
    assert not source.over


def test_a_file_that_grows_is_followed(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_bytes(b'{"t": 1}\n{"t"')
    with Run(JsonLines(Settings(str(path), follow=True))) as run:
        run.wait_for(1)
        with path.open("ab") as file:
            file.write(b": 2}\n")
        run.wait_for(2)
    assert [m.payload for m in run.messages] == [b'{"t": 1}', b'{"t": 2}']


def test_standard_input() -> None:
    program = (
        "import threading\n"
        "from residua.live.sources.stdin import JsonLines, Settings\n"
        "came = []\nsource = JsonLines(Settings())\nsource.start(came.append)\n"
        "while not source.over: threading.Event().wait(0.01)\n"
        "source.stop(); print(len(came), came[-1].payload.decode(), threading.active_count())"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], input=b"\n".join(lines(1000)), capture_output=True, timeout=60, check=True
    )
    assert done.stdout.decode().split(" ", 1) == ["1000", f"{lines(1000)[-1].decode()} 1\n"]


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    for path in (str(tmp_path / "none"), str(tmp_path)):
        with pytest.raises(SettingError, match=r"^path: .* is neither"):
            Settings(path)
    with pytest.raises(SettingError, match=r"^follow: true or false"):
        Settings(follow=1)  # pyright: ignore
