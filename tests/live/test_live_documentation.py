"""What the pages about sinks and the live page show is taken by the programs that it is for."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import textwrap
import time
from dataclasses import fields
from importlib import import_module
from pathlib import Path

import pytest

pytest.importorskip("httpx", reason="the extra 'live' is not installed")
pytest.importorskip("starlette", reason="the extra 'live' is not installed")

import httpx

from fake_view import FakeView
from residua.live.server import Server, Settings

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = ("live-sinks", "live-page")


def blocks(page: str, language: str) -> list[str]:
    """Return the blocks of a language in a page."""
    text = (DOCS / f"{page}.rst").read_text(encoding="utf-8")
    found = re.findall(rf"^\.\. code-block:: {language}\n\n(.*?)(?=^\S|\Z)", text, flags=re.DOTALL | re.MULTILINE)
    return [textwrap.dedent(block).strip() + "\n" for block in found]


@pytest.mark.parametrize("page", PAGES)
def test_configurations_are_taken(page, tmp_path):
    pytest.importorskip("paho.mqtt", reason="paho-mqtt, of the extra 'mqtt', is not installed")
    from residua.live.config import load_settings

    for k, block in enumerate(blocks(page, "toml")):
        path = tmp_path / f"{k}.toml"
        path.write_text(block)
        (tmp_path / "tank.json").write_text("{}")
        settings = load_settings(path)
        assert len(settings.sinks) == block.count("[[sinks]]")
        assert (settings.server is not None) == ("[server]" in block)


def test_every_setting_is_in_the_page():
    for page, modules in {
        "live-sinks": [f"residua.live.sinks.{kind}" for kind in ("webhook", "jsonl", "command", "mqtt")],
        "live-page": ["residua.live.server"],
    }.items():
        text = (DOCS / f"{page}.rst").read_text(encoding="utf-8")
        for module in modules:
            if module.endswith("mqtt"):
                pytest.importorskip("paho.mqtt", reason="paho-mqtt, of the extra 'mqtt', is not installed")
            for one in fields(import_module(module).Settings):
                assert re.search(rf"(``{one.name}\b|^   {one.name} = )", text, re.MULTILINE), f"{module}: {one.name}"


def promtool() -> str:
    tool = shutil.which("promtool")
    if tool is None:
        pytest.skip("no promtool, of Debian's prometheus, on this machine")
    return tool


def test_the_rules_are_rules(tmp_path):
    _, rules = blocks("live-page", "yaml")
    (tmp_path / "rules.yml").write_text(rules)
    done = subprocess.run(
        [promtool(), "check", "rules", str(tmp_path / "rules.yml")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "7 rules found" in done.stdout


def test_the_rules_name_metrics_that_are_there():
    _, rules = blocks("live-page", "yaml")
    view = FakeView.of({"north": "leak"})
    view.sinks.append({"name": "jsonl x", "kind": "jsonl", "good": True, "text": "", "behind": 0})
    from residua.live.view import metrics_text

    text = metrics_text(view).decode()
    for name in set(re.findall(r"residua_\w+", rules)):
        assert re.search(rf"^{name}[{{ ]", text, re.MULTILINE), name


def test_prometheus_scrapes_it_as_the_page_says(tmp_path):
    program = shutil.which("prometheus")
    if program is None:
        pytest.skip("no prometheus on this machine")
    token = tmp_path / "page.token"
    token.write_text("a token of twenty and more\n")
    token.chmod(0o600)
    view = FakeView.of({"north": "leak", "south": "healthy"})
    view.play(400)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    scrape, rules = blocks("live-page", "yaml")
    (tmp_path / "rules.yml").write_text(rules)
    with Server(view, Settings(token_file=str(token))) as running:
        scrape = scrape.replace("127.0.0.1:8000", f"127.0.0.1:{running.port}")
        often = "global:\n  scrape_interval: 1s\n  evaluation_interval: 1s\nrule_files: [rules.yml]\n"
        (tmp_path / "prometheus.yml").write_text(often + scrape)
        own = [f"--web.listen-address=127.0.0.1:{port}", f"--storage.tsdb.path={tmp_path / 'data'}"]
        quiet = subprocess.DEVNULL
        process = subprocess.Popen(
            [program, f"--config.file={tmp_path / 'prometheus.yml'}", *own], stdout=quiet, stderr=quiet
        )
        try:
            with httpx.Client(base_url=f"http://127.0.0.1:{port}/api/v1/", trust_env=False) as web:
                value = _asked(web, "residua_plants_in_alarm")
                assert value == "1"
                assert _asked(web, 'ALERTS{alertname="PlantHasAFault", alertstate="firing"}') == "1"
        finally:
            process.terminate()
            process.wait(20)


def _asked(web: httpx.Client, query: str) -> str:
    """Return the value of a query, once there is one."""
    for _ in range(300):
        try:
            result = web.get("query", params={"query": query}).json()["data"]["result"]
        except (httpx.HTTPError, ValueError, KeyError):
            result = []
        if result:
            return result[0]["value"][1]
        time.sleep(0.1)
    raise AssertionError(f"{query} has no value")
