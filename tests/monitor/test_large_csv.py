"""Large tables of text, which pyarrow reads: the same arrays and the same errors as the package's own reader."""

from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings, strategies as st

from residua.errors import ResiduaError
from residua.recording import csv_arrow
from residua.recording.csv_table import open_csv
from residua.recording.missing import Marks
from residua.recording.recording import read_recording

pytest.importorskip("pyarrow")

NUMBERS = st.one_of(
    st.floats().map(repr),
    st.integers(-(10**25), 10**25).map(str),
    st.sampled_from(["1e308", "-1e309", "1e-400", "5e-324", "2.2250738585072011e-308", ".5", "5.", "-0", "+1", "1E5"]),
)
ODD = st.sampled_from(
    ["", " ", "nan", "NaN", "-nan", "nan(1)", "nan()", "NA", "na ", "#VALUE!", "null", "NONE", "inf", "Infinity", "1_0"]
    + [
        "0x10",
        "1e",
        "1d5",
        "abc",
        "1,5",
        "1.5",
        "1 2",
        " 7",
        "7\t",
        "true",
        "#",
        "\x1b[31m",
        "é",
        "١",
        "\x00",
        '"',
        '""',
    ]
    + ['"1"', '" 2"', ' "3"', '"4" ', '"5', '6"', '"a""b"', '"1;2"', '"1,2"', '"x\ny"', '""""', '"7""', "\x0c", "\x85"]
    + ["2026-01-01", "3/4/2026", "1e400", "-", "+", ".", "e5", "1" * 400, "infinit", "nan\x1f", "−5", "1\r2"]
)
TIMES = st.sampled_from(["even", "dates", "other dates", "uneven"])


def time_cell(kind: str, k: int) -> str:
    if kind == "dates":
        return f"2026-01-01 00:00:{k:02d}"
    if kind == "other dates":
        return f'"{k + 1}.11.2026"'
    return str(k + (3 if kind == "uneven" and k == 2 else 0))


@st.composite
def tables(draw: st.DrawFn) -> str:
    """A table of text, with at most a few oddities, so that many are read."""
    delimiter = draw(st.sampled_from([",", ",", ";", "\t", " "]))
    width, rows = draw(st.integers(0, 3)), draw(st.integers(0, 6))
    kind = draw(TIMES)
    names = ["time", *[f"c{i}" for i in range(width)]]
    if draw(st.integers(0, 5)) == 0:
        names = [draw(st.sampled_from(["c1", "1", "température", "a;b", "", "c0"])) for _ in names]
    quoted = draw(st.booleans())
    lines = [[f'"{name}"' if quoted else name for name in names]] if draw(st.integers(0, 5)) else []
    lines += [[time_cell(kind, k), *[draw(NUMBERS) for _ in range(width)]] for k in range(rows)]
    if quoted and draw(st.booleans()):
        lines = [[cell if '"' in cell else f'"{cell}"' for cell in line] for line in lines]
    for _ in range(draw(st.integers(0, 2))):
        if lines and (line := draw(st.sampled_from(lines))):
            line[draw(st.integers(0, len(line) - 1))] = draw(ODD)
    texts = [delimiter.join(line) for line in lines]
    if draw(st.integers(0, 3)) == 0:
        extra = st.sampled_from(["", "  ", "\t\t", "# note", "%", "sep=;", ",,", '"', '""', "1", delimiter * width])
        texts.insert(draw(st.integers(0, len(texts))), draw(extra))
    end = draw(st.sampled_from(["\n", "\n", "\r\n", "\r"]))
    return end.join(texts) + draw(st.sampled_from(["", end, end * 3, " ", "\t"]))


def answer(path: Path, **options: Any) -> Any:
    try:
        one = read_recording(path, **options)
    except ResiduaError as error:
        return type(error), str(error)
    about = one.dt, one.source, one.columns, one.n_missing, one.origin, one.n_inserted, one.notes
    return one.time.tobytes(), np.nan_to_num(one.y, nan=0.125).tobytes(), np.isnan(one.y).tobytes(), about


@pytest.mark.parametrize("decimal", [".", ","])
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    text=tables(),
    encoding=st.sampled_from(["utf-8", "utf-8", "utf-8", "utf-8-sig", "utf-16"]),
    more=st.sampled_from([{}, {}, {"dt": 1.0}, {"columns": ["time", "c0", "c1"]}, {"transpose": True}, {"time": "c0"}]),
)
@example(text='time,c0\n0,"1"\n1,"2"\n', encoding="utf-8", more={})
@example(text='time;c0\n0;"1,5"\n1;"2,5"\n', encoding="utf-8", more={})
@example(text='"0","1,5"\n"1","2,5"\n', encoding="utf-8", more={})
@example(text='c0\n1\n\n""\n2\n', encoding="utf-8", more={"dt": 1.0})
def test_same_arrays_and_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, decimal: str, text: str, encoding: str, more: dict[str, Any]
) -> None:
    path = tmp_path / "data.csv"
    path.write_bytes(text.encode(encoding, errors="replace"))
    answers = []
    for large in (0, 10**9):
        monkeypatch.setattr(csv_arrow, "LARGE", large)
        answers.append(answer(path, decimal=decimal, **more))
    assert answers[0] == answers[1]


@pytest.mark.parametrize("beginning", [1, 20, 70])
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=tables())
def test_the_header_is_the_same_however_much_is_looked_at(
    monkeypatch: pytest.MonkeyPatch, beginning: int, text: str
) -> None:
    def opened(size: int) -> Any:
        monkeypatch.setattr("residua.recording.csv_table._BEGINNING", size)
        try:
            return open_csv(text.encode(errors="replace"), "data.csv")
        except ResiduaError as error:
            return type(error), str(error)

    assert opened(beginning) == opened(10**6)


SERVED = {
    "numbers": "0,1,2\n1,3,4\n",
    "empty cells": "0,,2\n1,3,\n",
    "quoted": '"0","1","2"\n"1","3","4"\n',
    "quoted text": '0,"a, b",2\n1,"say ""no""",4\n',
    "blank lines": "0,1,2\n\n1,3,4\n",
}
OTHER = {
    "a mark within a cell": '0,a"b,2\n',
    "a mark that is not closed": '0,"1,2\n',
    "a cell over two lines": '0,"1\n",2\n',
    "text after a quoted cell": '0,"1"2,2\n',
    "other letters": "0,é,2\n",
    "control characters": "0,\x1b,2\n",
    "NaN with a payload": "0,nan(1),2\n",
    "a line of 200,000 characters": f"0,{'1' * 200_000},2\n",
}


@pytest.mark.parametrize("text", SERVED.values(), ids=SERVED)
def test_what_pyarrow_reads(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setattr(csv_arrow, "LARGE", 0)
    body = csv_arrow.served(text, 3, ",", ".")
    assert body is not None
    numbers = body.numbers([2, 0], Marks())
    assert numbers is not None
    np.testing.assert_array_equal(numbers[1], [0.0, 1.0])


@pytest.mark.parametrize("text", OTHER.values(), ids=OTHER)
def test_what_is_left_to_the_other_reader(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setattr(csv_arrow, "LARGE", 0)
    assert csv_arrow.served(text, 3, ",", ".") is None


def test_without_pyarrow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(csv_arrow, "LARGE", 0)
    path = tmp_path / "data.csv"
    path.write_text('"time","c0"\n0,1\n1,2\n')
    whole = answer(path)
    importing = builtins.__import__

    def without(name: str, *rest: Any, **more: Any) -> Any:
        if name.startswith("pyarrow"):
            raise ImportError(name)
        return importing(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    assert answer(path) == whole


def test_a_wrong_cell_far_down_is_named_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    lines = [f'{k},"{k / 7!r}",{k * 1e-3!r}' for k in range(150_000)]
    lines[140_000] = '140000,"1,5",2'
    path.write_text("\n".join(['"time","a","b"', *lines]))
    assert path.stat().st_size > csv_arrow.LARGE
    _, text = answer(path)
    assert text.startswith("data.csv: column 'a', line 140002: expected a number, got '1,5'; if its comma is a decimal")
