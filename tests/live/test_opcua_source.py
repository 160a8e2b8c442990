"""Values from a real OPC UA server."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

asyncua = pytest.importorskip("asyncua", reason="asyncua is not installed")

from asyncua import ua  # noqa: E402

from live.brokers import Run, free_port, wait_for  # noqa: E402
from live.opcua_server import URI, VARIABLES, OpcUaServer  # noqa: E402
from residua.live.sources.opcua import OpcUa, Settings  # noqa: E402

NODES = {"north": {"level": "ns=2;s=north.level", "flow": "ns=2;s=north.flow"}}
BEGIN = 1_700_000_000.0


@pytest.fixture(autouse=True)
def quiet() -> None:
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)


@pytest.fixture
def server() -> Iterator[OpcUaServer]:
    with OpcUaServer(free_port()) as one:
        yield one


def of(run: Run, channel: str) -> list[tuple[Any, Any]]:
    """The values of a channel with their times, those that were there before left out."""
    return [(m.payload, m.time) for m in run.messages if m.channel == channel and m.time and m.time < 1.75e9]


def test_every_value_comes_once_in_order_to_its_last_bit(server: OpcUaServer) -> None:
    source = OpcUa(Settings(server.url, NODES, interval=0.05))
    with Run(source) as run:
        run.connected()
        run.wait_for(2)  # what is there now
        rows = [(k / 3, -k / 7, BEGIN + k / 8) for k in range(1, 301)]
        for k in range(0, 300, 50):
            part = rows[k : k + 50]
            server.set_all([one for a, b, t in part for one in (("north.level", a, t), ("north.flow", b, t))])
        run.wait_for(602)
        time.sleep(0.2)
    assert of(run, "level") == [(a, t) for a, _, t in rows]
    assert of(run, "flow") == [(b, t) for _, b, t in rows]
    times = [m.time for m in run.messages[2:]]
    assert times == sorted(times)  # pyright: ignore
    assert {(m.plant, m.refused) for m in run.messages} == {("north", "")}


def test_a_status_that_is_not_good_is_a_missing_value(server: OpcUaServer) -> None:
    source = OpcUa(Settings(server.url, {"north": {name: f"ns=2;s={name}" for name in VARIABLES}}, interval=0.05))
    with Run(source) as run:
        run.connected()
        run.wait_for(len(VARIABLES))
        codes = (ua.StatusCodes.Good, ua.StatusCodes.BadSensorFailure, ua.StatusCodes.UncertainLastUsableValue)
        for k, code in enumerate(codes):
            server.set("north.level", 1.5, BEGIN + k, code)
        values = [("text", "words"), ("flag", True), ("whole", 7), ("whole", 7), ("north.flow", [1.0, 2.0])]
        for k, (name, value) in enumerate(values):  # the same at another time comes too
            server.set(name, value, BEGIN + 3 + k)
        run.wait_for(len(VARIABLES) + 8)
    came = [(m.payload, m.refused) for m in run.messages[len(VARIABLES) :]]
    assert came[0] == (1.5, "")
    assert all(math.isnan(x) and not why for x, why in came[1:3])  # pyright: ignore
    assert all(math.isnan(x) and why == "number" for x, why in (came[3], came[7]))  # pyright: ignore
    assert came[4:7] == [(1.0, ""), (7.0, ""), (7.0, "")]
    assert [m.time for m in run.messages[len(VARIABLES) :]] == [BEGIN + k for k in range(8)]


def test_it_connects_again_when_the_server_is_back(server: OpcUaServer) -> None:
    source = OpcUa(Settings(server.url, NODES, interval=0.05))
    with Run(source) as run:
        for k in range(2):
            run.connected()
            server.set("north.level", 1.0 + k, BEGIN + k)
            wait_for(lambda k=k: (1.0 + k, BEGIN + k) in of(run, "level"))
            server.stop()
            wait_for(lambda: not source.health.good, 30.0)
            server.start()
        run.connected()


def test_a_run_that_takes_nothing_holds_up_the_server(server: OpcUaServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("residua.live.sources.opcua._MOST", 50)
    source = OpcUa(Settings(server.url, NODES, interval=0.05, queue=100_000))
    with Run(source, most=10) as run:
        run.connected()
        run.wait_for(2)
        run.takes.clear()
        server.set_all([("north.level", float(k), BEGIN + k) for k in range(1000)])
        wait_for(lambda: len(source.queue) > 50)
        time.sleep(1.0)
        held = len(source.queue) + run.waiting
        server.set_all([("north.level", float(k), BEGIN + k) for k in range(1000, 3000)])
        time.sleep(2.0)
        assert source.health.good
        assert len(source.queue) + run.waiting == held < 3000
        run.takes.set()
        run.wait_for(3002, 60.0)
    assert of(run, "level") == [(float(k), BEGIN + k) for k in range(3000)]


def test_nodes_by_namespace_and_by_pattern_and_those_that_are_not_there(server: OpcUaServer) -> None:
    settings = Settings(
        server.url,
        {"one": {"level": f"nsu={URI};s=north.level", "none": "ns=2;s=none", "far": "nsu=urn:other;i=1"}},
        plants=("north", "south"),
        channels={"level": "ns=2;s=north.level", "flow": "ns=2;s={plant}.flow"},
    )
    source = OpcUa(settings)
    with Run(source) as run:
        run.connected()
        run.wait_for(4)
        assert "3 are not there" in source.health.text
    assert {(m.plant, m.channel) for m in run.messages} == {
        ("one", "level"), ("north", "level"), ("south", "level"), ("north", "flow"),
    }  # fmt: skip


def test_a_server_that_is_not_there_or_has_no_such_nodes_is_said(server: OpcUaServer) -> None:
    source = OpcUa(Settings(f"opc.tcp://127.0.0.1:{free_port()}", NODES))
    with Run(source):
        wait_for(lambda: "tries again" in source.health.text)
    source = OpcUa(Settings(server.url, {"north": {"level": "ns=2;s=none"}}))
    with Run(source):
        wait_for(lambda: "has none of the nodes" in source.health.text)


def test_users_and_certificates(tmp_path: Path) -> None:
    from asyncua.crypto.cert_gen import setup_self_signed_certificate
    from asyncua.crypto.permission_rules import User, UserRole
    from asyncua.server.user_managers import UserManager

    class Users(UserManager):
        def get_user(self, iserver: Any, username: Any = None, password: Any = None, certificate: Any = None) -> Any:
            return User(role=UserRole.User) if (username, password) == ("plant", "right secret") else None

    import asyncio
    import socket

    from cryptography.x509.oid import ExtendedKeyUsageOID

    files = {}
    for who, uri, usage in (
        ("server", "urn:server", ExtendedKeyUsageOID.SERVER_AUTH),
        ("client", "urn:residua:live", ExtendedKeyUsageOID.CLIENT_AUTH),
    ):
        key, certificate = tmp_path / f"{who}.key.pem", tmp_path / f"{who}.der"
        asyncio.run(setup_self_signed_certificate(key, certificate, uri, socket.gethostname(), [usage], {}))
        files[who] = (str(certificate), str(key))

    async def prepare(server: Any) -> None:
        server.iserver.user_manager = Users()
        await server.set_application_uri("urn:server")
        server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
        await server.load_certificate(files["server"][0])
        await server.load_private_key(files["server"][1])

    word = tmp_path / "word"
    with OpcUaServer(free_port(), prepare=prepare) as server:
        for password, good in (("wrong secret", False), ("right secret", True)):
            word.write_text(password)
            word.chmod(0o600)
            settings = Settings(
                server.url,
                NODES,
                username="plant",
                password_file=str(word),
                policy="Basic256Sha256",
                cert_file=files["client"][0],
                key_file=files["client"][1],
                server_cert_file=files["server"][0],
            )
            source = OpcUa(settings)
            with Run(source) as run:
                if good:
                    run.connected()
                    run.wait_for(2)
                else:
                    wait_for(lambda source=source: "tries again" in source.health.text, 30.0)
                assert "secret" not in source.health.text
