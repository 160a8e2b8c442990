"""Settings of sources, sinks and the server: each error names its key, and repeats no secret."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import pytest

from residua.errors import MissingExtraError, SettingError

NODES = {"north": {"level": "ns=2;s=north.level", "flow": "ns=2;s=north.flow"}}
#: By module: settings that are right as they are, and settings that make them wrong, with the message.
WRONG: dict[str, tuple[dict[str, Any], list[tuple[dict[str, Any], str]]]] = {
    "sources.mqtt": (
        {"client_id": "run", "topics": ["{plant}/data"]},
        [
            ({"client_id": ""}, "client_id: a name for this run"),
            ({"topics": []}, "topics: name at least one"),
            ({"topics": "plants/{plant}/data"}, "topics: a list of different texts"),
            ({"topics": ["$share/a/b"]}, "topics: "),
            ({"qos": 2}, "qos: 2 takes a message over before it is saved"),
            ({"qos": True}, "qos: one of 1, 0"),
            ({"port": 70000}, "port: a whole number"),
            ({"version": "4"}, "version: one of '5', '3.1.1'"),
            ({"ca_file": __file__}, "ca_file: it is for TLS"),
            ({"tls": True, "ca_file": "none.pem"}, "ca_file: none.pem is not a file"),
            ({"tls": True, "cert_file": __file__}, "cert_file: a certificate and its key"),
            ({"keepalive": 1}, "keepalive: a whole number from 5"),
            ({"password_file": "a", "password_env": "b"}, "password_file and password_env"),
            ({"host": ""}, "host: "),
            ({"host": "a\nb"}, "host: text on one line"),
        ],
    ),
    "sources.kafka": (
        {"servers": ["localhost:9092"], "group": "g", "topics": ["plants"]},
        [
            ({"servers": []}, "servers: name at least one broker"),
            ({"servers": ["localhost"]}, "servers: a list of host:port"),
            ({"servers": "localhost:9092"}, "servers: a list of different texts"),
            ({"group": ""}, "group: "),
            ({"topics": ["a/b"]}, "topics: 'a/b'"),
            ({"topics": ["tags.{channel}"]}, "topics: topic tags.{channel} does not identify the plant"),
            ({"start": "now"}, "start: one of"),
            ({"session_timeout": 1}, "session_timeout: a whole number from 6"),
            ({"ca_file": __file__}, "ca_file: it is for TLS"),
            ({"username": "a"}, "mechanism: with username"),
            ({"mechanism": "PLAIN", "username": "a"}, "mechanism: with username"),
        ],
    ),
    "sources.opcua": (
        {"url": "opc.tcp://localhost:4840", "nodes": NODES},
        [
            ({"url": "http://localhost:4840"}, "url: opc.tcp"),
            ({"url": "opc.tcp://user:word@localhost:4840"}, "url: opc.tcp"),
            ({"url": "opc.tcp://localhost"}, "url: opc.tcp"),
            ({"nodes": {}}, "nodes: name at least one node"),
            ({"nodes": {"north": {"level": "level"}}}, "nodes: 'level' is not a node"),
            ({"nodes": {"north": {"level": 3}}}, "nodes: 'north': a table from text to text"),
            ({"plants": ("a",)}, "channels: plants whose nodes"),
            ({"plants": ("north",), "channels": {"level": "ns=2;s=x"}}, "nodes: level of north has two nodes"),
            ({"interval": 0}, "interval: a number from 0.01"),
            ({"policy": "None"}, "policy: one of"),
            ({"policy": "Basic256Sha256"}, "cert_file: a policy needs"),
            ({"cert_file": __file__}, "cert_file: a policy needs"),
        ],
    ),
    "sources.replay": (
        {},
        [
            ({}, "file: name the recording"),
            ({"file": "none.csv"}, "file: none.csv is not a file"),
            ({"files": {"north": "none.csv"}}, "files: none.csv, of north, is not a file"),
            ({"file": __file__, "speed": -1.0}, "speed: a number of at least 0"),
            ({"file": __file__, "speed": float("nan")}, "speed: a number"),
            ({"file": __file__, "rows": 0}, "rows: a whole number from 1 to 10,000"),
            ({"file": __file__, "rows": True}, "rows: a whole number"),
            ({"file": __file__, "times": "then"}, "times: one of 'own', 'now'"),
            ({"file": __file__, "plants": ["a", "a"]}, "plants: a list of different texts"),
            ({"file": __file__, "columns": {"a": 1}}, "columns: a table from text to text"),
        ],
    ),
    "sinks.command": (
        {},
        [
            ({"command": ()}, "command"),
            ({"command": "echo hello"}, "command: a list"),
            ({"command": ("",)}, "command"),
            ({"command": ("echo", 3)}, "command: a list"),
            ({"command": ("echo", "a\0b")}, "command: a list"),
            ({"command": ("true",), "timeout": 0.0}, "timeout"),
        ],
    ),
    "sinks.mqtt": (
        {},
        [
            ({"host": ""}, "host"),
            ({"host": "b", "port": 70000}, "port"),
            ({"host": "b", "port": "1883"}, "port: a whole number"),
            ({"host": "b", "topic": "a/+/b"}, "topic"),
            ({"host": "b", "topic": ""}, "topic"),
            ({"host": "b", "ca_file": "x"}, "tls = true"),
            ({"host": "b", "version": "3.1"}, "version"),
            ({"host": "b", "timeout": 0.0}, "timeout"),
            ({"host": "b", "password_env": "P"}, "username"),
            ({"host": "b", "username": "u", "password_env": "P", "password_file": "f"}, "only one of them"),
        ],
    ),
    "sinks.webhook": (
        {},
        [
            ({}, "url"),
            ({"url": "https://x.org", "url_env": "X"}, "just one of|only one"),
            ({"url": "http://x.org/hook", "key_env": "K"}, "https is needed to reach x.org"),
            ({"url": "http://localhost.x.org/", "key_env": "K"}, "https is needed"),
            ({"url": "ftp://x.org", "key_env": "K"}, "https://"),
            ({"url": "nonsense", "key_env": "K"}, "https://"),
            ({"url": "https://me:pass@x.org", "key_env": "K"}, "no user or password"),
            ({"url": "https://x.org"}, "key_file or key_env.*unsigned"),
            ({"url": "https://x.org", "key_env": "K", "unsigned": True}, "unsigned"),
            ({"url": "https://x.org", "key_env": "K", "timeout": 0.0}, "timeout"),
            ({"url": "https://x.org", "key_env": "K", "timeout": float("nan")}, "timeout"),
            ({"url": "https://x.org", "key_env": "K", "timeout": "10"}, "timeout: a number"),
            ({"url": "https://x.org", "key_env": "K", "drop_refused": "no"}, "drop_refused: true or false"),
            ({"url": "https://x.org", "key_env": "K", "proxy": "http://me:pass@p"}, "proxy: no user"),
        ],
    ),
    "server": (
        {},
        [
            ({"listen": "8000"}, "listen"),
            ({"listen": "example.org:80"}, "listen"),
            ({"listen": "127.0.0.1:99999"}, "listen"),
            ({"listen": "127.0.0.1:"}, "listen"),
            ({"listen": "::1:80x"}, "listen"),
            ({"hosts": ("https://x.org",)}, "hosts"),
            ({"hosts": "x.org"}, "hosts: a list of texts"),
            ({"https": "yes"}, "https: true or false"),
            ({"token_env": "A", "token_file": "b"}, "only one of them"),
        ],
    ),
}


@pytest.mark.parametrize(
    ("module", "wrong", "message"),
    [(module, wrong, message) for module, (_, cases) in WRONG.items() for wrong, message in cases],
    ids=lambda one: one if isinstance(one, str) else ",".join(one),
)
def test_wrong_settings_are_named(module: str, wrong: dict[str, Any], message: str) -> None:
    try:
        settings = import_module(f"residua.live.{module}").Settings
    except MissingExtraError as error:
        pytest.skip(str(error))
    right = WRONG[module][0]
    with pytest.raises(SettingError, match=message) as caught:
        settings(**right | wrong)
    assert "pass@" not in str(caught.value)
