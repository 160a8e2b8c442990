"""A sample of the campaign of damaged files, that the campaign sees what is wrong, and damage that once went wrong."""

from __future__ import annotations

import csv
import io
import os
import random
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
import scipy.io

import residua as rs
from damaged import FILES, assert_nothing_wrong
from residua.errors import DataError, FileFormatError, ModelError, SettingError
from residua.recording import mat_files
from residua.visible import MAX_ECHO, echo, listed, shortened, visible

SAMPLE = 30


@pytest.mark.parametrize("name", FILES.kinds())
def test_whole_files_are_read(name: str, tmp_path: Path) -> None:
    """Else every damaged one would be refused, whatever its damage."""
    kind = FILES.kinds()[name]()
    for content in kind.samples:
        path = tmp_path / f"file{kind.ending}"
        path.write_bytes(content)
        if kind.ending == ".csv" and b";" in content[:10]:  # that one is there to be asked about
            with pytest.raises(DataError, match="decimal comma"):
                kind.read(path, content)
        else:
            assert kind.read(path, content)


@pytest.mark.parametrize("name", FILES.kinds())
def test_a_sample_of_the_campaign(name: str) -> None:
    assert_nothing_wrong(FILES.run(FILES.kinds()[name](), SAMPLE), SAMPLE)


def test_the_campaign_sees_what_is_wrong(tmp_path: Path) -> None:
    """Readers that take what they get, or raise what they like, are found out."""

    def wrong(read: object) -> list[str]:
        whole = FILES.Kind("x", ".json", (b"{}",), (lambda rng, content: content,), read)
        outcome = FILES.Outcome()
        FILES._one(whole, random.Random(0), tmp_path / "file.json", outcome)
        return [text for text, _ in outcome.wrong]

    def refusing(text: str) -> object:
        def read(path: Path, whole: bytes) -> str:
            raise FileFormatError(text)

        return read

    def failing(path: Path, whole: bytes) -> str:
        raise AttributeError

    assert wrong(lambda path, whole: FILES.SAME) == []
    assert wrong(refusing("short")) == []
    assert "AttributeError" in wrong(failing)[0]
    assert "repeats" in wrong(refusing("Z" * 300))[0]
    assert "characters" in wrong(refusing("A " * 2000))[0]


def test_the_campaign_sees_a_blind_monitor(tmp_path: Path) -> None:
    monitor = next(FILES.monitors())
    spec = monitor._specification()
    found = monitor.update(*FILES.FAULTY)
    FILES.assert_sees(found, spec)
    found.statistic[0, -1] = np.nan
    with pytest.raises(AssertionError, match="blind"):
        FILES.assert_sees(found, spec)


def test_the_table_of_the_documentation_is_that_of_the_campaign() -> None:
    with FILES.TABLE.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    assert tuple(header) == FILES.HEADER
    assert [row[0] for row in rows] == list(FILES.kinds())
    for row in rows:
        total, *parts = map(int, row[1:])
        assert sum(parts) == total
        assert parts[-1] == 0


# ----------------------------------------------------------------------- .mat files


def mat_file(path: Path, **content: object) -> Path:
    scipy.io.savemat(path, content or {"u": FILES.SHORT[0], "y": FILES.SHORT[1]}, do_compression=True)
    return path


def test_a_mat_file_is_read_to_the_last_bit(tmp_path: Path) -> None:
    found = rs.read_recording(mat_file(tmp_path / "r.mat"), FILES.MODEL)
    assert np.array_equal(found.u, FILES.SHORT[0])
    assert np.array_equal(found.y, FILES.SHORT[1])


CRASHES = "import os, signal, sys; "


@pytest.mark.parametrize(
    ("ends", "words"),
    [
        ("os.kill(os.getpid(), signal.SIGSEGV)", "SIGSEGV"),
        ("os.abort()", "SIGABRT"),
        ("os._exit(3)", "status 3"),
        ("sys.exit()", "status 0"),
    ],
)
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_reader_that_dies_is_an_error_about_the_file(
    ends: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    child = tmp_path / "child.py"
    child.write_text(CRASHES + ends)
    monkeypatch.setattr(mat_files.array_child, "__file__", str(child))
    with pytest.raises(FileFormatError, match=rf"r\.mat: the reader .*{words}.*damaged"):
        rs.read_recording(mat_file(tmp_path / "r.mat"), FILES.MODEL)


def test_a_reader_that_does_not_end_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    child = tmp_path / "child.py"
    child.write_text("import time; time.sleep(600)")
    monkeypatch.setattr(mat_files.array_child, "__file__", str(child))
    monkeypatch.setattr(mat_files, "_PATIENCE", 0.5)
    with pytest.raises(FileFormatError, match="it took too long"):
        rs.read_recording(mat_file(tmp_path / "r.mat"), FILES.MODEL)


def test_reading_needs_an_interpreter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    with pytest.raises(FileFormatError, match="needs a Python interpreter"):
        rs.read_recording(mat_file(tmp_path / "r.mat"), FILES.MODEL)


def test_cells_and_structures_are_named_and_not_read(tmp_path: Path) -> None:
    cell = np.array([[np.arange(3.0)], ["text"]], dtype=object)
    path = mat_file(tmp_path / "r.mat", c=cell, s={"a": 1.0})
    with pytest.raises(DataError, match=r"c \(no numbers\), s \(no numbers\)"):
        rs.read_recording(path, FILES.MODEL)


# ---------------------------------------------------------------- what is packed


def test_a_mat_file_that_unpacks_to_more_than_it_may_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = mat_file(tmp_path / "zeros.mat", u=np.zeros((10**6, 1)), y=np.zeros((10**6, 2)))
    assert path.stat().st_size < 100_000
    monkeypatch.setenv("RESIDUA_MAX_UNPACKED", "20000000")
    with pytest.raises(FileFormatError, match="RESIDUA_MAX_UNPACKED to a larger"):
        rs.read_recording(path, FILES.MODEL)
    monkeypatch.setenv("RESIDUA_MAX_UNPACKED", "30000000")
    assert len(rs.read_recording(path, FILES.MODEL)) == 10**6


@pytest.mark.parametrize("ending", [".npz", ".parquet"])
def test_an_archive_that_unpacks_to_more_than_it_may_is_refused(
    ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"zeros{ending}"
    zeros = {name: np.zeros(10**6) for name in ("pump", "level 1", "level 2")}
    if ending == ".npz":
        np.savez_compressed(path, **zeros)
    else:
        rs.monitor.write_table(path, zeros)
    assert path.stat().st_size < 1_000_000
    monkeypatch.setenv("RESIDUA_MAX_UNPACKED", "20000000")
    with pytest.raises(FileFormatError, match="RESIDUA_MAX_UNPACKED to a larger"):
        rs.read_recording(path, FILES.MODEL)
    monkeypatch.setenv("RESIDUA_MAX_UNPACKED", "30000000")
    assert len(rs.read_recording(path, FILES.MODEL)) == 10**6


@pytest.mark.parametrize("text", ["many", "-1", "0", "1e9", "9" * 50])
def test_the_limit_is_a_number_of_bytes(text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RESIDUA_MAX_UNPACKED", text)
    with pytest.raises(SettingError, match="RESIDUA_MAX_UNPACKED must be a number of bytes"):
        rs.read_recording(mat_file(tmp_path / "r.mat"), FILES.MODEL)


def npz_of(header: bytes, content: bytes = b"") -> bytes:
    """Return an archive with one array whose header says something."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("u.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + content)
    return out.getvalue()


@pytest.mark.parametrize(
    "header",
    [
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }\n",  # NumPy would make room for it
        b"{'descr': '|O', 'fortran_order': False, 'shape': (1,), }\n",
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (\n",  # TokenError
        b"{'descr': 7, 'fortran_order': False, 'shape': (1,), }\n",
        b"__import__('os').abort()\n",
        b"\xff\n",
        b"[" * 5000,
    ],
)
def test_headers_of_arrays_that_say_what_is_not_there(header: bytes, tmp_path: Path) -> None:
    (tmp_path / "r.npz").write_bytes(npz_of(header))
    with pytest.raises(FileFormatError, match=r"^r\.npz: "):
        rs.read_recording(tmp_path / "r.npz", FILES.MODEL)


def test_packed_content_that_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / "r.npz"
    np.savez_compressed(path, u=FILES.SHORT[0], y=FILES.SHORT[1])
    content = bytearray(path.read_bytes())
    content[60:90] = zlib.compress(b"other")[:20] + bytes(10)
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=r"not a readable \.npz"):
        rs.read_recording(path, FILES.MODEL)


# ---------------------------------------------------------------- numbers and words


@pytest.mark.parametrize("number", ["1e308", "-1e308", "1.1e100", "1e999", "inf", "nan", "9" * 400])
@pytest.mark.parametrize("line", ["A = [[0.9, 0.05]", "operating_point = [2.0]", "process = ", "state = "])
def test_numbers_of_a_model_that_no_product_holds_are_refused(number: str, line: str, tmp_path: Path) -> None:
    text = FILES.dumps_plant(FILES.plant())
    start = text.index(line.split("[")[0])
    place = next(found for found in FILES.damaged_text.__globals__["_NUMBER"].finditer(text, start))
    (tmp_path / "p.toml").write_text(text[: place.start()] + number + text[place.end() :])
    with pytest.raises(FileFormatError, match=r"^p\.toml: "):
        rs.plant.load_plant(tmp_path / "p.toml")


def test_numbers_of_a_model_are_at_most_a_googol() -> None:
    with pytest.raises(ModelError, match=r"A\[0, 0\] is 1e\+308: every entry of a model must be at most 1e\+100"):
        rs.Plant([[1e308]], [[1.0]], [[1.0]])
    with pytest.raises(ModelError, match=r"operating_point.*at most 1e"):
        rs.Plant([[0.5]], [[1.0]], [[1.0]]).with_operating_point(outputs={"y1": 1e308})
    assert rs.Plant([[1e100]], [[1.0]], [[1.0]]).A[0, 0] == 1e100


def test_messages_repeat_little_and_send_nothing_to_a_terminal() -> None:
    assert len(echo("Z" * 10**6)) <= MAX_ECHO
    assert len(echo(list(range(10**4)))) <= MAX_ECHO
    assert len(listed(["name"] * 10**5)) <= MAX_ECHO
    assert listed([]) == "none"
    assert shortened("abcdef", 5) == "ab..."
    assert visible("a\x1b[2Jb\x9bc\u202ed\ne") == "a\\x1b[2Jb\\x9bc\\u202ed\ne"
    assert str(FileFormatError("a\x1b[2J")) == "a\\x1b[2J"


@pytest.mark.parametrize("name", ["Z" * 5000, "\x1b]0;owned\x07"])
def test_names_in_files_are_repeated_that_way(name: str, tmp_path: Path) -> None:
    table = tmp_path / "r.csv"
    cases = {
        "r.csv": [f"time,pump,{name},level 2\n0,1,2,3\n", f"time,pump,level 1,level 2\n0,1,{name},3\n1,1,2,3\n"],
        "p.toml": [
            FILES.dumps_plant(FILES.plant()).replace("level 1 sensor", FILES.json.dumps(name)[1:-1], 1) * 2,
            f"{FILES.json.dumps(name)} = 1\nformat = 'residua-plant/1'\n",
            f"format = {FILES.json.dumps(name)}\n",
        ],
        "m.json": [f'{{"format": "residua-monitor", "version": 6, {FILES.json.dumps(name)}: 1}}'],
    }
    for file, texts in cases.items():
        for text in texts:
            table = tmp_path / file
            table.write_text(text)
            read = {"r.csv": rs.read_recording, "p.toml": rs.plant.load_plant, "m.json": rs.Monitor.load}[file]
            with pytest.raises((FileFormatError, DataError)) as caught:
                read(table, FILES.MODEL) if file == "r.csv" else read(table)
            assert FILES.wrong_message(str(caught.value)) == ""


def test_the_reader_is_started_with_the_paths_of_this_process(tmp_path: Path) -> None:
    """Where a package was put on the path by hand, the process that reads needs it too."""
    path = mat_file(tmp_path / "r.mat")
    code = (
        "import sys; from residua.recording import mat_files; sys.path.insert(0, 'elsewhere'); "
        "print(sorted(mat_files.read_mat(__import__('pathlib').Path(sys.argv[1]))))"
    )
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "['u', 'y']", done.stderr
