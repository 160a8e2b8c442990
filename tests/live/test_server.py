"""The server: who is let in, what is answered, and that others cannot stop it."""

from __future__ import annotations

import contextlib
import json
import logging
import re
import shutil
import socket
import subprocess
import threading
import time

import pytest

from fake_view import FakeView

httpx = pytest.importorskip("httpx", reason="the extra 'live' is not installed")
pytest.importorskip("uvicorn", reason="the extra 'live' is not installed")

from residua.errors import SettingError  # noqa: E402
from residua.live import routes, server  # noqa: E402
from residua.report.live_page import live_policy  # noqa: E402

PATHS = ("/", "/overview.json", "/plant/north.json", "/events", "/metrics", "/health", "/nothing", "/plant/../metrics")


def watched() -> FakeView:
    made = FakeView.of({"north": "leak", "hall 3/pump & <b>ü": "healthy"})
    made.sources.append({"name": "mqtt b:1883", "kind": "mqtt", "good": True, "text": "connected"})
    made.sinks.append({"name": "jsonl x", "kind": "jsonl", "good": True, "text": "delivers", "behind": 0})
    made.play(400)
    return made


@pytest.fixture(scope="module")
def standing():
    """A server that no test changes."""
    with server.Server(watched()) as made:
        yield made


@pytest.fixture
def view():
    return watched()


@pytest.fixture
def running(view):
    with server.Server(view) as made:
        yield made


def token(running) -> str:
    return running.address.partition("?token=")[2]


@contextlib.contextmanager
def client(running, **headers):
    base = running.address.partition("/?")[0]
    headers = {"Authorization": f"Bearer {token(running)}"} | headers
    with httpx.Client(base_url=base, headers=headers, timeout=10, trust_env=False) as made:
        yield made


def raw(running, path: str, *lines: str, method: str = "GET", host: str | None = None) -> tuple[int, str]:
    """Return status and text of a request that is sent exactly so."""
    bearer = f"Authorization: Bearer {token(running)}"
    head = [f"{method} {path} HTTP/1.1", f"Host: {host or f'127.0.0.1:{running.port}'}", bearer, "Connection: close"]
    with socket.create_connection(("127.0.0.1", running.port), 10) as connection:
        connection.sendall("\r\n".join([*head, *lines, "", ""]).encode())
        answer = b""
        while piece := connection.recv(65536):
            answer += piece
    return int(answer.split()[1]), answer.decode("utf-8", "replace")


# ------------------------------------------------------------- who is let in


@pytest.mark.parametrize("path", PATHS)
def test_nobody_without_the_token(standing, path):
    with client(standing, Authorization="") as web:
        for headers in (
            {},
            {"Authorization": "Bearer wrong"},
            {"Authorization": token(standing)},
            {"Cookie": "residua=1"},
        ):
            answer = web.get(path, headers=headers)
            assert answer.status_code == 401
            assert "token" in answer.text
            assert "residua live" in answer.text
            assert "set-cookie" not in answer.headers


def test_the_address_is_answered_with_a_cookie_that_scripts_cannot_read(standing):
    with httpx.Client(trust_env=False) as web:
        page = web.get(standing.address)
        assert page.status_code == 200
        cookie = page.headers["set-cookie"]
        assert re.fullmatch(r"residua-[0-9a-f]{12}=[0-9a-f]{64}; Path=/; HttpOnly; SameSite=Strict", cookie)
        assert token(standing) not in cookie
        base = standing.address.partition("/?")[0]
        for path in ("/", "/overview.json", "/metrics", "/plant/north.json"):
            again = web.get(base + path)
            assert again.status_code == 200
            assert "set-cookie" not in again.headers
        assert web.get(base + "/?token=wrong").status_code == 401
        assert web.get(f"{base}/overview.json?token={token(standing)}", headers={"Cookie": ""}).status_code == 401


def test_the_cookie_of_one_run_does_not_open_another(view):
    with server.Server(view) as one, server.Server(view) as other, httpx.Client(trust_env=False) as web:
        assert web.get(one.address).status_code == 200
        assert web.get(other.address.partition("?")[0]).status_code == 401


def test_a_token_of_ones_own(view, tmp_path, monkeypatch):
    file = tmp_path / "token"
    file.write_text("a token of twenty and more\n")
    file.chmod(0o600)
    with server.Server(view, server.Settings(token_file=str(file))) as made:
        assert token(made) == "a token of twenty and more"
        with client(made) as web:
            assert web.get("/health").status_code == 200
    monkeypatch.setenv("SHORT_TOKEN", "short")
    with pytest.raises(SettingError, match="token: at least 20"):
        server.Server(view, server.Settings(token_env="SHORT_TOKEN"))


@pytest.mark.parametrize(
    "host",
    ["evil.example", "localhost", "127.0.0.1", "127.0.0.1:1", "evil.example:{port}", "127.0.0.1.evil.example:{port}",
     "10.0.0.1:{port}", "a@127.0.0.1:{port}", "127.0.0.1:{port}/", "", "[::1", "localhost:{port}:80"],
)  # fmt: skip
def test_another_host_is_not_this_server(standing, host):
    status, text = raw(standing, "/overview.json", host=host.format(port=standing.port) or " ")
    assert status in (400, 421)
    assert "north" not in text


@pytest.mark.parametrize("host", ["127.0.0.1:{port}", "localhost:{port}", "LocalHost:{port}", "[::1]:{port}"])
def test_names_of_this_machine(standing, host):
    assert raw(standing, "/overview.json", host=host.format(port=standing.port))[0] == 200


def test_a_request_with_two_hosts_is_refused(standing):
    assert raw(standing, "/health", "Host: evil.example")[0] in (400, 421)


def test_a_proxy_in_front(view):
    settings = server.Settings(hosts=("alarms.example.org",), https=True)
    with server.Server(view, settings) as made, client(made, Host="alarms.example.org") as web:
        assert web.get("/health").status_code == 200
        assert web.get("/health", headers={"Origin": "https://alarms.example.org"}).status_code == 200
        assert web.get("/health", headers={"Origin": "http://alarms.example.org"}).status_code == 403
        page = web.get("/", params={"token": token(made)})
        assert page.headers["set-cookie"].endswith("; SameSite=Strict; Secure")


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors", "Sec-Fetch-Dest": "image"},
        {"Sec-Fetch-Site": "same-site", "Sec-Fetch-Mode": "no-cors", "Sec-Fetch-Dest": "script"},
        {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "iframe"},
    ],
)
@pytest.mark.parametrize("path", ["/overview.json", "/events", "/"])
def test_pages_of_others_read_nothing(standing, path, headers):
    with client(standing, **headers) as web:
        answer = web.get(path)
        assert answer.status_code == 403
        assert "access-control-allow-origin" not in answer.headers


def test_its_own_page_and_a_link_to_it_are_answered(standing):
    base = standing.address.partition("/?")[0]
    with client(standing) as web:
        assert web.get("/overview.json", headers={"Origin": base, "Sec-Fetch-Site": "same-origin"}).status_code == 200
        link = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
        assert web.get("/", headers=link).status_code == 200


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "TRACE", "NONSENSE"])
def test_nothing_can_be_changed(standing, method):
    assert raw(standing, "/overview.json", method=method)[0] == 405


def test_the_token_is_in_no_log_and_no_error(view, caplog, capfd):
    caplog.set_level(logging.DEBUG)
    view.plant = lambda plant: 1 / 0  # an error inside is logged, with its trace
    with server.Server(view) as made:
        with httpx.Client(trust_env=False) as web:
            assert web.get(made.address).status_code == 200
            base = made.address.partition("/?")[0]
            assert web.get(base + "/plant/north.json").status_code == 500
            assert web.get(f"{base}/nothing?token={token(made)}").status_code == 404
        raw(made, "/%zz?token=" + token(made))
        with socket.create_connection(("127.0.0.1", made.port)) as odd:
            odd.sendall(b"nonsense " + token(made).encode() + b"\r\n\r\n")
            odd.recv(1000)
        secret = token(made)
    out, err = capfd.readouterr()
    ours = "\n".join(record.getMessage() for record in caplog.records if not record.name.startswith("http"))
    assert "ZeroDivisionError" in caplog.text
    assert secret not in ours + out + err
    assert secret not in repr(made)


def test_every_answer_says_that_it_is_not_kept_nor_framed(standing):
    for path in PATHS:
        if path == "/events":
            continue
        with client(standing) as web:
            for answer in (web.get(path), web.get(path, headers={"Authorization": "x"})):
                assert answer.headers["cache-control"] == "no-store"
                assert answer.headers["x-content-type-options"] == "nosniff"
                assert answer.headers["x-frame-options"] == "DENY"
                assert answer.headers["referrer-policy"] == "no-referrer"
                assert answer.headers["cross-origin-resource-policy"] == "same-origin"
                assert "server" not in answer.headers
    with client(standing) as web:
        policy = web.get("/").headers["content-security-policy"]
    assert policy == live_policy()
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["connect-src"] == "'self'"
    assert rules["frame-ancestors"] == "'none'"
    assert "unsafe" not in rules["script-src"]


# ---------------------------------------------------------------- what is said


def test_the_overview_goes_by_pages(running, view):
    with client(running) as web:
        assert web.get("/overview.json").json() == json.loads(json.dumps(view.overview()))
        rows = [row["plant"] for row in web.get("/overview.json").json()["rows"]]
        assert [r["plant"] for r in web.get("/overview.json?first=1&count=1").json()["rows"]] == rows[1:]
        found = web.get("/overview.json", params={"find": "PUMP & <"}).json()
        assert [row["plant"] for row in found["rows"]] == ["hall 3/pump & <b>ü"]
        for wrong in ("first=-1", "count=x", "first=1e3", "count=" + "9" * 30, "first=٣"):
            assert web.get(f"/overview.json?{wrong}").status_code == 400


def test_plants_by_their_ids_whatever_these_are(running, view):
    with client(running) as web:
        for path in ("/plant/north.json", "/plant/hall%203%2Fpump%20%26%20%3Cb%3E%C3%BC.json"):
            answer = web.get(path)
            assert answer.status_code == 200
            assert answer.headers["content-type"] == "application/json"
        assert answer.json()["plant"] == "hall 3/pump & <b>ü"
        assert web.get("/plant/south.json").status_code == 404


@pytest.mark.parametrize(
    "path",
    ["/plant/", "/plant/.json", "/plant/north", "/plant/../overview.json", "/plant/..%2foverview.json", "/etc/passwd",
     "//overview.json", "/overview.json/", "/./overview.json", "/static/../overview.json", "/plant/north.json/",
     "/plant/%2e%2e.json", "/plant/%ff%fe.json", "/plant/north%00.json", "/plant//north.json",
     "/PLANT/north.json", "/plant/north.json%2f..",
     "/..%5c..%5cwindows", "/%2e%2e/%2e%2e/etc/passwd", "http://evil.example/overview.json", "/favicon.ico", "*"],
)  # fmt: skip
def test_path_tricks_lead_nowhere(standing, path):
    status, text = raw(standing, path)
    assert status in (404, 400) if path == "*" else status == 404
    assert "leak" not in text


def test_values_that_json_does_not_know_become_null(running, view):
    told = view.overview()
    told["rows"][0]["ratio"] = float("nan")
    view.overview = lambda *_: told
    with client(running) as web:
        assert web.get("/overview.json").json()["rows"][0]["ratio"] is None


def test_health_says_what_is_wrong(running, view):
    with client(running) as web:
        assert web.get("/health").json() == {"good": True, "reasons": []}
        view.sinks[0] |= {"good": False, "text": "the disk is full"}
        view.problems.append("the store is away")
        answer = web.get("/health")
        assert answer.status_code == 503
        assert answer.json()["reasons"] == ["the store is away", "jsonl x: the disk is full"]


def test_health_of_a_run_that_does_not_answer(running, view, monkeypatch):
    monkeypatch.setattr(routes, "ANSWER_TIMEOUT", 0.2)
    over = threading.Event()
    view.overview = lambda *_: over.wait(20)
    with client(running) as web:
        answer = web.get("/health")
    over.set()
    assert answer.status_code == 503
    assert "did not answer" in answer.json()["reasons"][0]


def test_metrics_are_those_of_the_view(standing):
    with client(standing) as web:
        answer = web.get("/metrics")
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    text = answer.text
    assert 'residua_plants_in_alarm{model="three tanks",shard="0"} 1.0' in text
    assert 'residua_dropped_total{reason="a \\"quoted\\"\\nreason"} 1.0' in text
    assert 'residua_messages_total{source="mqtt b:1883"} 100.0' in text
    assert "residua_oldest_age_seconds{" in text
    assert "residua_plant_ratio" not in text


def test_one_series_for_each_plant_only_when_asked(view):
    with server.Server(view, server.Settings(per_plant=True)) as made, client(made) as web:
        text = web.get("/metrics").text
    assert re.search(r'residua_plant_ratio\{plant="north"\} \d', text)
    assert text.count("residua_plant_ratio{") == 2


@pytest.mark.parametrize("per_plant", [False, True])
def test_prometheus_finds_nothing_to_say_about_the_metrics(view, per_plant):
    tool = shutil.which("promtool")
    if tool is None:
        pytest.skip("no promtool, of Debian's prometheus, on this machine")
    with server.Server(view, server.Settings(per_plant=per_plant)) as made, client(made) as web:
        text = web.get("/metrics").text
    done = subprocess.run([tool, "check", "metrics"], input=text, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


# ------------------------------------------------------------------- events


def streamed(web, until: int, **asked) -> tuple[list[int], list[str]]:
    """Return the ids up to one, and the kinds of what else came."""
    ids, others = [], []
    with web.stream("GET", "/events", **asked) as answer:
        assert answer.status_code == 200
        assert answer.headers["content-type"] == "text/event-stream"
        for line in answer.iter_lines():
            if line.startswith("id: "):
                ids.append(int(line[4:]))
            elif line.startswith("event: "):
                others.append(line[7:])
            if line == "" and ids and ids[-1] >= until:
                return ids, others
    return ids, others


def test_events_as_they_happen_and_from_any_place_on(running, view):
    count = len(view.events)
    with client(running) as web:
        with web.stream("GET", "/events?after=0") as answer:
            text = ""
            for piece in answer.iter_text():
                text += piece
                if f"id: {count}\n" in text:
                    break
        data = [json.loads(line[6:]) for line in text.splitlines() if line.startswith("data: ")]
        assert data == [e.to_dict() for e in view.events]
        assert streamed(web, count, params={"after": 2})[0] == list(range(3, count + 1))
        later = threading.Timer(0.3, view.tell, ["north", "ended", 700.0])
        later.start()
        begun = time.monotonic()
        ids, others = streamed(web, count + 1)  # from now on
        assert ids == [count + 1]
        assert others == ["beat"]  # it says where now is
        assert time.monotonic() - begun < 2.0
        later.join()


def test_a_lost_connection_goes_on_without_a_hole(running, view):
    """Cut at any place: what a browser says it has seen last decides, not the address that it began with."""
    seen: list[int] = []
    last = len(view.events) + 300

    def tell() -> None:
        while len(view.events) < last:
            view.tell("north", "missing", 0.0)
            time.sleep(0.002)

    teller = threading.Thread(target=tell)
    teller.start()
    with client(running) as web:
        while not seen or seen[-1] < last:
            headers = {"Last-Event-ID": str(seen[-1])} if seen else {}
            until = min((seen[-1] if seen else 0) + 37, last)
            seen += streamed(web, until, params={"after": 0}, headers=headers)[0]
    teller.join()
    assert seen == list(range(1, last + 1))


def test_a_long_backlog_comes_whole(running, view):
    for k in range(3 * routes.PIECE + 7):
        view.tell("north", "missing", k)
    count = len(view.events)
    with client(running) as web:
        assert streamed(web, count, params={"after": 0})[0] == list(range(1, count + 1))


def test_signs_of_life(running, view, monkeypatch):
    monkeypatch.setattr(routes, "HEARTBEAT", 0.1)
    with client(running) as web, web.stream("GET", "/events?after=1") as answer:
        text = ""
        for piece in answer.iter_text():
            text += piece
            if text.count("event: beat") >= 3:
                break
    assert f'data: {{"last": {len(view.events)}}}' in text


def test_a_place_of_another_store_is_said_to_be_void(running, view):
    with client(running) as web:
        ids, others = streamed(web, 1, params={"after": 10_000})
    assert others == ["anew"]
    assert ids == [len(view.events)]


def test_a_place_that_is_none(standing):
    with client(standing) as web:
        for wrong in ("x", "-1", "1.5", "9" * 30):
            assert web.get(f"/events?after={wrong}").status_code == 400


def test_only_so_many_follow_and_room_comes_back(running, monkeypatch):
    monkeypatch.setattr(routes, "MOST_FOLLOWERS", 3)
    with client(running) as web:
        with contextlib.ExitStack() as stack:
            for _ in range(3):
                assert stack.enter_context(web.stream("GET", "/events?after=0")).status_code == 200
            full = web.get("/events")
            assert full.status_code == 503
            assert full.headers["retry-after"] == "10"
        for _ in range(100):
            with web.stream("GET", "/events") as answer:
                if answer.status_code == 200:
                    return
            time.sleep(0.05)
    raise AssertionError("who has left still takes room")


def test_a_follower_who_takes_nothing_is_left(running, view, monkeypatch):
    monkeypatch.setattr(routes, "SEND_TIMEOUT", 0.5)
    monkeypatch.setattr(routes, "HEARTBEAT", 0.2)
    monkeypatch.setattr(routes, "MOST_FOLLOWERS", 1)
    long = "x" * 100_000
    with socket.create_connection(("127.0.0.1", running.port)) as lazy:
        lazy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        head = (
            f"GET /events?after=0 HTTP/1.1\r\nHost: 127.0.0.1:{running.port}\r\nAuthorization: Bearer {token(running)}"
        )
        lazy.sendall(head.encode() + b"\r\n\r\n")
        time.sleep(0.2)
        for k in range(100):
            view.tell("north", "missing", k, channels=[long])
        with client(running) as web:
            for _ in range(200):
                with web.stream("GET", "/events") as answer:
                    if answer.status_code == 200:
                        return
                time.sleep(0.05)
    raise AssertionError("it still takes room")


# ------------------------------------------------------------ many, and the end


@contextlib.contextmanager
def idle(port: int, count: int, sent: bytes = b""):
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, min(4096, hard)), hard))
    opened: list[socket.socket] = []
    try:
        for _ in range(count):
            one = socket.create_connection(("127.0.0.1", port), 10)
            if sent:
                with contextlib.suppress(OSError):
                    one.sendall(sent)
            opened.append(one)
        yield opened
    finally:
        for one in opened:
            one.close()


@pytest.mark.parametrize("sent", [b"", b"GET / HTTP/1.1\r\nHost: x\r\nX-Slow: "], ids=["silent", "slow"])
def test_a_thousand_idle_connections_stop_nothing(running, view, sent):
    pytest.importorskip("resource", reason="limits of POSIX")
    with client(running) as follower, follower.stream("GET", f"/events?after={len(view.events)}") as following:
        lines = following.iter_lines()
        assert next(lines).startswith("retry")
        with idle(running.port, 1000, sent), client(running) as web:
            for path in ("/", "/overview.json", "/plant/north.json", "/metrics", "/health"):
                begun = time.monotonic()
                assert web.get(path).status_code == 200
                assert time.monotonic() - begun < 2.0
            assert len(running._uvicorn.server_state.connections) <= server.MOST_CONNECTIONS + 1
            begun, event = time.monotonic(), view.tell("north", "ended", 900.0)
            while next(lines) != f"id: {event.place}":  # who follows was not cut off
                assert time.monotonic() - begun < 2.0


def test_connections_without_a_request_are_closed(view, monkeypatch):
    monkeypatch.setattr(server, "IDLE", 0.3)
    with server.Server(view) as made, idle(made.port, 2) as (silent, slow):
        slow.sendall(b"GET / HTTP/1.1\r\nX-Slow: ")
        for one in (silent, slow):
            one.settimeout(5)
            with contextlib.suppress(ConnectionResetError):
                assert one.recv(1) == b""


def test_heads_without_end_are_refused(running):
    with socket.create_connection(("127.0.0.1", running.port), 10) as connection, contextlib.suppress(OSError):
        connection.sendall(b"GET / HTTP/1.1\r\nX: " + b"x" * 200_000)
        connection.recv(100)
    with client(running) as web:
        assert web.get("/health").status_code == 200


def test_it_ends_while_others_follow(view):
    before = set(threading.enumerate())
    made = server.Server(view)
    made.start()
    with client(made) as web, web.stream("GET", "/events"):
        begun = time.monotonic()
        made.stop()
        assert time.monotonic() - begun < 5.0
    left = {thread.name for thread in set(threading.enumerate()) - before}
    assert not left & {"residua-server", "residua-news"}
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", made.port), 2)


def test_it_listens_on_this_machine_alone(standing):
    assert standing.address.startswith("http://127.0.0.1:")
    assert standing._socket.getsockname()[0] == "127.0.0.1"


def test_a_port_that_is_taken(view, running):
    with pytest.raises(SettingError, match=r"listen: .* cannot be opened for connections: Address already in use"):
        server.Server(view, server.Settings(listen=f"127.0.0.1:{running.port}"))
