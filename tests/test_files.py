"""Files: whole or not at all, the permissions of any other file, and one way to say what is wrong."""

from __future__ import annotations

import errno
import os
import stat
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

import residua as rs
from residua import files
from residua.errors import FileFormatError
from residua.files import check_input, replacing, write_text
from residua.library import gertler, three_tank
from residua.plant import load_plant, save_plant
from residua.recording.recording import read_recording
from residua.recording.table_writer import write_table

WRITERS: dict[str, Callable[[Path], object]] = {
    "text": lambda path: write_text(path, "x"),
    "plant": lambda path: save_plant(gertler(), path),
    "csv": lambda path: write_table(path.with_suffix(".csv"), {"a": [1.0]}),
    "parquet": lambda path: write_table(path.with_suffix(".parquet"), {"a": [1.0]}),
    "monitor": lambda path: rs.Monitor(rs.design.kalman_filter(three_tank())).save(path),
}
READERS: dict[str, Callable[[Path], object]] = {
    "plant": load_plant,
    "csv": lambda path: read_recording(path.with_suffix(".csv")),
    "parquet": lambda path: read_recording(path.with_suffix(".parquet")),
    "mat": lambda path: read_recording(path.with_suffix(".mat")),
    "npz": lambda path: read_recording(path.with_suffix(".npz")),
    "monitor": rs.Monitor.load,
}


@pytest.mark.parametrize("kind", WRITERS)
def test_a_missing_folder_is_said_in_the_same_words(kind: str, tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"the folder .*nowhere does not exist; make it first"):
        WRITERS[kind](tmp_path / "nowhere" / "file")


@pytest.mark.parametrize("kind", READERS)
def test_a_missing_file_is_said_in_the_same_words(kind: str, tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"absent.*: [a-z ]+ not found"):
        READERS[kind](tmp_path / "absent")
    for ending in ("", ".csv", ".parquet", ".mat", ".npz"):
        (tmp_path / f"absent{ending}").mkdir()
    with pytest.raises(FileFormatError, match=r"is a folder; name a "):
        READERS[kind](tmp_path / "absent")


@pytest.mark.parametrize("kind", WRITERS)
def test_new_files_have_the_usual_permissions_and_nothing_is_left(kind: str, tmp_path: Path) -> None:
    (tmp_path / "usual").write_text("")
    WRITERS[kind](tmp_path / "file")
    modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()}
    assert len(modes) == 2
    assert len(set(modes.values())) == 1


def test_an_old_file_stays_when_writing_fails(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    path.write_text("old")
    path.chmod(0o640)

    def write_half() -> None:
        with replacing(path) as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        write_half()
    assert path.read_text() == "old"
    write_text(path, "new")
    assert path.read_text() == "new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert [p.name for p in tmp_path.iterdir()] == ["file.txt"]


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="is a folder; name a file"):
        write_text(tmp_path, "x")
    with pytest.raises(FileFormatError, match="is a folder; name a plant file"):
        check_input(tmp_path, "plant file")


def test_threads_that_write_one_file_do_not_mix_nor_touch_the_mask(tmp_path: Path) -> None:
    mask = os.umask(0o027)
    try:
        path = tmp_path / "file.txt"
        texts = [letter * 100_000 for letter in "abcdefgh"]
        threads = [threading.Thread(target=write_text, args=(path, text)) for text in texts]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert path.read_text() in texts
        assert stat.S_IMODE(path.stat().st_mode) == 0o640
        assert os.umask(0o027) == 0o027
    finally:
        os.umask(mask)


# ------------------------------------------------------------------ killed runs and full disks


def next_run(path: Path) -> None:
    """Write a file as a new process would: it has looked through no folder yet."""
    files._swept.clear()
    write_text(path, "new")


def test_partial_files_of_killed_runs_are_removed_and_those_of_others_stay(tmp_path: Path) -> None:
    (tmp_path / ".residua-own.csv").write_text("a file of the user, by chance of such a name")
    killed = """
import os, sys
from residua.files import replacing
with replacing(sys.argv[1]) as temporary:
    temporary.write_text("half")
    os.kill(os.getpid(), 9)
"""
    subprocess.run([sys.executable, "-c", killed, str(tmp_path / "killed.csv")], check=False)
    (left,) = tmp_path.glob(".residua-*.partial.csv")
    os.utime(left, (left.stat().st_atime, left.stat().st_mtime - 0.9 * files._LEFT))
    next_run(tmp_path / "file.txt")
    assert left.exists()  # another process may be writing it
    os.utime(left, (left.stat().st_atime, left.stat().st_mtime - 0.2 * files._LEFT))
    next_run(tmp_path / "file.txt")
    assert sorted(path.name for path in tmp_path.iterdir()) == [".residua-own.csv", "file.txt"]


def test_a_file_is_on_the_disk_before_it_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    happened: list[str] = []
    for name in ("fsync", "replace"):
        real = getattr(os, name)
        monkeypatch.setattr(os, name, lambda *a, _name=name, _real=real: (happened.append(_name), _real(*a))[1])
    write_text(tmp_path / "file.txt", "content")
    assert happened[:2] == ["fsync", "replace"]


def test_a_full_disk_names_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_space(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", no_space)
    for write in WRITERS.values():
        with pytest.raises(FileFormatError, match=r"file(\.\w+)?: it cannot be written: No space left"):
            write(tmp_path / "file")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_device_names_itself() -> None:
    with pytest.raises(FileFormatError, match=r"^/dev/full: it cannot be written: No space left"):
        write_text("/dev/full", "x" * 100_000)
