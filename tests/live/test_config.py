"""A configuration is read as a whole, and what is wrong with it is one line with the key and its line."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from live_runs import configuration
from residua.errors import DataError, FileFormatError
from residua.live.config import example, load_settings
from residua.live.run import Run

GOOD = """[[monitors]]
file = "tank.json"
plants = ["north"]

[[sources]]
kind = "stdin"

[store]
file = "live.db"

[sampling]
wait = 2.0
"""


def written(folder: Path, text: str) -> Path:
    (folder / "tank.json").touch()
    path = folder / "live.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_example_is_a_configuration(tmp_path: Path) -> None:
    text = example()
    assert list(tomllib.loads(text)) == ["monitors", "sources", "sampling", "store", "sinks", "server"]
    for package in ("paho.mqtt", "uvicorn"):
        pytest.importorskip(package)
    settings = load_settings(written(tmp_path, text))
    assert settings.monitors[0].name == "tank"
    assert Path(settings.monitors[0].file) == tmp_path / "tank.json"
    assert [kind for kind, _ in (*settings.sources, *settings.sinks)] == ["mqtt", "jsonl"]


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("wait = 2.0", "wiat = 2.0", 12, "sampling.wiat: unknown; did you mean wait?"),
        ("wait = 2.0", "wait = -1", 12, "sampling.wait: a number from 0"),
        ("wait = 2.0", 'wait = "2"', 12, "sampling.wait: a number from 0"),
        ("wait = 2.0", "silence = 0", 12, "sampling.silence: more than 0 seconds"),
        ('kind = "stdin"', 'kind = "stdio"', 6, "sources.kind: unknown: 'stdio'; there are"),
        ('kind = "stdin"', "", 5, "sources.kind: missing; there are"),
        ('kind = "stdin"', 'kind = "stdin"\npath = "absent.jsonl"', 7, "sources.path:"),
        ('file = "live.db"', "", 8, "store.file: the file of the store"),
        ('file = "live.db"', 'file = "live.db"\nhistory = 0', 10, "store.history: more than 0 seconds"),
        ('file = "live.db"', 'kind = "postgresql"', 8, "store.dsn_file: either dsn_file or dsn_env"),
        ('file = "live.db"', 'dsn = "x"', 9, "store.dsn: unknown; secrets come from dsn_file or dsn_env"),
        ('plants = ["north"]', "", 1, "monitors.plants: name the plants, or set accept_new = true"),
        ('plants = ["north"]', 'plants = "north"', 3, "monitors.plants: a list of different texts"),
        ('plants = ["north"]', 'plants = ["a", "a"]', 3, "monitors.plants: a list of different texts"),
        ('plants = ["north"]', 'plants = ["a", "b"]\nmax_plants = 1', 4, "monitors.max_plants: 2 plants are listed"),
        ('file = "tank.json"\n', "", 1, "monitors.file: missing"),
        ("[sampling]", "[samplin]", 11, "samplin: unknown"),
        ("[sampling]", "[[sampling]]", 11, "sampling: must be a table, [sampling]"),
        ("[[monitors]]", "[monitors]", 1, "monitors: must be tables, [[monitors]]"),
        ("[[sources]]", "[sources]", 5, "sources: must be tables, [[sources]]"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path: Path, old: str, new: str, line: int, said: str) -> None:
    path = written(tmp_path, GOOD.replace(old, new, 1))
    with pytest.raises(FileFormatError) as error:
        load_settings(path)
    text = str(error.value)
    assert text.startswith(f"{path}, line {line}: {said}"), text
    assert "\n" not in text


def test_secrets_in_the_configuration_are_refused_and_not_repeated(tmp_path: Path) -> None:
    pytest.importorskip("paho.mqtt")
    source = 'kind = "mqtt"\nclient_id = "x"\ntopics = ["a/{plant}"]\npassword = "hidden"'
    with pytest.raises(FileFormatError, match="secrets come from password_file or password_env") as error:
        load_settings(written(tmp_path, GOOD.replace('kind = "stdin"', source)))
    assert "hidden" not in str(error.value)


@pytest.mark.parametrize("content", [b"[[monitors", b"\xff\xfe", b"a = " + b"[" * 10_000])
def test_what_is_no_toml(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "live.toml"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match="no TOML"):
        load_settings(path)


def test_two_monitors_do_not_watch_one_plant(tmp_path: Path) -> None:
    more = '[[monitors]]\nfile = "tank.json"\nname = "other"\nplants = ["north"]\n'
    with pytest.raises(FileFormatError, match="'north' has another monitor already"):
        load_settings(written(tmp_path, GOOD + more))
    with pytest.raises(FileFormatError, match="there is another monitor 'tank'"):
        load_settings(written(tmp_path, GOOD + more.replace('name = "other"\n', "").replace("north", "south")))


def test_two_sources_of_one_name(tmp_path: Path) -> None:
    source = '[[sources]]\nkind = "stdin"\nname = "a"'
    with pytest.raises(DataError, match="two sources are called 'a'"):
        Run(load_settings(configuration(tmp_path, source, source)))
