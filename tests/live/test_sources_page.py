"""What the page "Live sources" shows can be configured, and the messages on it are read."""

from __future__ import annotations

import json
import re
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

from residua.live.config import SOURCES
from residua.live.readings import Layout, readings_of
from residua.live.source import Message
from residua.live.sources.topics import Topics

PAGE = (Path(__file__).parents[2] / "docs" / "live-sources.rst").read_text(encoding="utf-8")
PACKAGES = {"mqtt": "paho.mqtt", "opcua": "asyncua", "kafka": "confluent_kafka"}


def blocks(language: str) -> list[str]:
    found = re.findall(rf"code-block:: {language}\n\n((?:   .*\n|\n)+)", PAGE)
    return ["\n".join(line[3:] for line in block.splitlines()) for block in found]


def test_there_is_an_example_of_every_source() -> None:
    assert sorted(tomllib.loads(one)["sources"][0]["kind"] for one in blocks("toml")) == sorted(SOURCES)


@pytest.mark.parametrize("text", blocks("toml"))
def test_an_example_is_a_configuration(text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("rows.jsonl", "week.parquet", "south.csv"):
        Path(name).touch()
    (source,) = tomllib.loads(text)["sources"]
    kind = source.pop("kind")
    if kind in PACKAGES:
        pytest.importorskip(PACKAGES[kind])
    settings = import_module(SOURCES[kind][0]).Settings(**source)
    assert settings.name == ""


def test_every_message_is_read() -> None:
    layout = Layout(("valve",), ("level", "flow"), 0.5)
    lines = [line for block in blocks("json") for line in block.splitlines() if line]
    assert len(lines) == 4
    for line in lines:
        readings = readings_of(Message(None, line.encode(), 0.0), lambda _: layout)  # pyright: ignore
        assert len(readings.times) == len(readings.values) == (2 if "[[" in line else 1)
        assert readings.plant == json.loads(line)["plant"] == "north"
    for text in re.findall(r"A topic or node of one channel brings ``(.*?)``, ``(.*?)``, or ``(.*?)``", PAGE)[0]:
        readings = readings_of(Message(None, text.encode(), 7.0, "north", "level"), lambda _: layout)  # pyright: ignore
        assert readings.times == [0.5 if "value" in text else 7.0]


def test_what_the_page_says_of_limits() -> None:
    from residua.live.run import MOST_MESSAGES
    from residua.live.source import LARGEST

    assert f"{LARGEST:,} bytes" in PAGE
    assert f"some {MOST_MESSAGES:,} messages wait" in PAGE
    assert Topics(["sensors/{plant}/{channel}"]).place("sensors/north/level") == ("north", "level")
