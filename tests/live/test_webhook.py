"""Webhooks: signed, in order, again until they are taken, and nothing else than what was asked for."""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import json
import socket
import threading
import time

import pytest

from certificates import certificates
from receiver import Receiver, events
from residua.errors import SettingError
from residua.live.delivery import DeliveryError

pytest.importorskip("httpx", reason="the extra 'live' is not installed")

from residua.live.sinks import webhook

KEY = "a key that nobody guesses"


@pytest.fixture(autouse=True)
def key(monkeypatch):
    monkeypatch.setenv("THE_KEY", KEY)


@contextlib.contextmanager
def sink(url, **settings):
    made = webhook.Webhook(webhook.Settings(url=url, **({"key_env": "THE_KEY", "timeout": 2.0} | settings)))
    try:
        yield made
    finally:
        made.close()


def verified(headers, body, key=KEY, now=None, tolerance=300):
    """What docs/live-sinks shows: whether a signature is right and fresh."""
    parts = dict(part.split("=", 1) for part in headers["Residua-Signature"].split(","))
    expected = hmac.new(key.encode(), f"{parts['t']}.".encode() + body, hashlib.sha256).hexdigest()
    fresh = abs((time.time() if now is None else now) - int(parts["t"])) <= tolerance
    return hmac.compare_digest(expected, parts["v1"]) and fresh


def test_each_event_is_one_signed_post():
    with Receiver() as receiver, sink(receiver.url) as made:
        assert made.deliver(events(3)) == 3
    assert [path for path, _, _ in receiver.received] == ["/hook"] * 3
    assert [body.decode() for _, _, body in receiver.received] == [e.to_json() for e in events(3)]
    for _, headers, body in receiver.received:
        assert headers["Content-Type"] == "application/json"
        assert verified(headers, body)
        assert not verified(headers, body + b" ")
        assert not verified(headers, body, key="another key")
        assert not verified(headers, body, now=time.time() + 1000)


def test_a_token_and_no_signature(monkeypatch):
    monkeypatch.setenv("THE_TOKEN", "abc.def")
    with Receiver() as receiver, sink(receiver.url, key_env="", unsigned=True, token_env="THE_TOKEN") as made:
        made.deliver(events(1))
    (_, headers, _) = receiver.received[0]
    assert headers["Authorization"] == "Bearer abc.def"
    assert "Residua-Signature" not in headers


def test_what_was_not_taken_comes_again_from_there():
    with Receiver(lambda n: 503 if n == 3 else 200) as receiver, sink(receiver.url) as made:
        assert made.deliver(events(5)) == 2
        assert made.deliver(events(5)[2:]) == 3
    assert [json.loads(body)["number"] for _, _, body in receiver.received] == [1, 2, 3, 3, 4, 5]


@pytest.mark.parametrize("drop_refused", [False, True])
@pytest.mark.parametrize(
    ("status", "words"),
    [
        (302, "redirect"),
        (400, "refuses the event.*drop_refused"),
        *((status, "refuses the event") for status in (413, 415, 422)),
        *((status, "does not let this sink in") for status in (401, 403)),
        (404, "look at the address"),
        *((status, "cannot take the event now") for status in (408, 409, 429, 500, 503)),
    ],
)
def test_other_answers_are_said_and_keep_the_event(status, words, drop_refused):
    """Only an event that is refused for good is given up, where that is asked for."""
    dropped = drop_refused and words.startswith("refuses")
    receiver = Receiver(lambda n: status if n == 1 else 200)
    with receiver, sink(receiver.url, drop_refused=drop_refused) as made:
        if dropped:
            assert made.deliver(events(3)) == 3
        else:
            with pytest.raises(DeliveryError, match=words) as caught:
                made.deliver(events(3))
            assert str(status) in str(caught.value)
        assert made.dropped == dropped
    assert len(receiver.received) == (3 if dropped else 1)  # nobody was followed elsewhere, and order is kept


def test_a_receiver_that_is_away_and_comes_back():
    receiver = Receiver()
    with sink(receiver.url) as made:
        assert made.deliver(events(1)) == 1
        receiver.close()
        for _ in range(2):
            with pytest.raises(DeliveryError, match=r"127\.0\.0\.1:\d+(:| cannot be reached)"):
                made.deliver(events(3)[1:])
        with Receiver(port=receiver.port) as back:
            assert made.deliver(events(3)[1:]) == 2
    assert [json.loads(body)["number"] for _, _, body in back.received] == [2, 3]


@pytest.mark.parametrize("drips", [False, True])
def test_a_receiver_that_does_not_answer_is_left_in_time(drips):
    """Whether it says nothing, or sends its answer byte by byte for ever."""
    over = threading.Event()

    def serve(listening: socket.socket) -> None:
        connection, _ = listening.accept()
        answer = (bytes([byte]) for byte in b"HTTP/1.1 200 OK\r\nX-Long: " + 1000 * b"x")
        with connection, contextlib.suppress(OSError):
            while not over.wait(0.05):
                if drips:
                    connection.sendall(next(answer))

    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=serve, args=(listening,))
        thread.start()
        begun = time.monotonic()
        address = f"http://127.0.0.1:{listening.getsockname()[1]}/"
        with sink(address, timeout=0.5) as made, pytest.raises(DeliveryError, match=r"no answer within 0\.5 s"):
            made.deliver(events(2))
        assert time.monotonic() - begun < 3.0
        over.set()
        thread.join()


def test_it_is_left_at_once_while_it_delivers():
    answers = threading.Event()
    with Receiver(lambda n: 200 if answers.wait(20) else 500) as receiver:
        made = webhook.Webhook(webhook.Settings(url=receiver.url, key_env="THE_KEY", timeout=20.0))
        failed: list[DeliveryError] = []

        def deliver() -> None:
            try:
                made.deliver(events(1))
            except DeliveryError as error:
                failed.append(error)

        thread = threading.Thread(target=deliver)
        thread.start()
        while not receiver.received:
            time.sleep(0.01)
        begun = time.monotonic()
        made.close()
        assert time.monotonic() - begun < 5.0
        thread.join(5.0)
        answers.set()
    assert [str(one) for one in failed] == ["the run is ending"]


def test_the_environment_sends_nothing_elsewhere(monkeypatch, tmp_path):
    """No proxy and no password of the environment is used."""
    netrc = tmp_path / "netrc"
    netrc.write_text("machine 127.0.0.1 login somebody password something\n")
    netrc.chmod(0o600)
    monkeypatch.setenv("NETRC", str(netrc))
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:9")
    with Receiver() as receiver, sink(receiver.url) as made:
        assert made.deliver(events(1)) == 1
    assert "Authorization" not in receiver.received[0][1]


def test_nothing_secret_is_said(monkeypatch, caplog):
    secrets = {"THE_URL": "http://127.0.0.1:9/services/hidden-path", "THE_TOKEN": "hidden-token", "THE_KEY": KEY}
    for name, value in secrets.items():
        monkeypatch.setenv(name, value)
    caplog.set_level("DEBUG")
    made = webhook.Webhook(webhook.Settings(url_env="THE_URL", key_env="THE_KEY", token_env="THE_TOKEN"))
    with pytest.raises(DeliveryError) as caught:
        made.deliver(events(1))
    made.close()
    said = " ".join([made.name, str(caught.value), repr(caught.value.__cause__), caplog.text])
    assert made.name == "webhook http://127.0.0.1:9"
    assert not any(word in said for word in ("hidden", "services", KEY))


def test_keys_that_can_be_guessed_and_certificates_that_are_none(monkeypatch, tmp_path):
    monkeypatch.setenv("SHORT", "short")
    with pytest.raises(SettingError, match="key: 5 characters can be guessed"):
        webhook.Webhook(webhook.Settings(url="https://x.org", key_env="SHORT"))
    monkeypatch.setenv("BLANK", "two words")
    with pytest.raises(SettingError, match=r"token: .*no blanks"):
        webhook.Webhook(webhook.Settings(url="https://x.org", key_env="THE_KEY", token_env="BLANK"))
    with pytest.raises(SettingError, match="ca_file"):
        webhook.Webhook(webhook.Settings(url="https://x.org", key_env="THE_KEY", ca_file=str(tmp_path / "none")))
    monkeypatch.setenv("PLAIN", "http://x.org/")
    with pytest.raises(SettingError, match="url_env: https is needed"):
        webhook.Webhook(webhook.Settings(url_env="PLAIN", key_env="THE_KEY"))


def test_https_to_a_certificate_of_ones_own(tmp_path):
    certificate = certificates(tmp_path)
    with Receiver(certificate=certificate) as receiver:
        with sink(receiver.url, ca_file=str(certificate[0])) as made:
            assert made.name == f"webhook https://127.0.0.1:{receiver.port}"
            assert made.deliver(events(3)) == 3
        assert [body.decode() for _, _, body in receiver.received] == [e.to_json() for e in events(3)]
        assert all(verified(headers, body) for _, headers, body in receiver.received)


@pytest.mark.parametrize(
    ("address", "first_day", "known", "words"),
    [
        ("127.0.0.1", -1, False, "self-signed certificate"),  # nobody vouches for it
        ("127.0.0.2", -1, True, "IP address mismatch"),  # of another machine
        ("127.0.0.1", -3, True, "certificate has expired"),
        ("127.0.0.1", 1, True, "certificate is not yet valid"),
    ],
)
def test_no_event_goes_to_a_receiver_that_may_be_another(tmp_path, address, first_day, known, words):
    certificate = certificates(tmp_path, address, first_day)
    with (
        Receiver(certificate=certificate) as receiver,
        sink(receiver.url, ca_file=str(certificate[0]) if known else "") as made,
    ):
        with pytest.raises(DeliveryError, match=f"cannot be reached: .*{words}"):
            made.deliver(events(1))
        assert not receiver.received


def test_https_to_a_receiver_without_it_is_refused():
    with Receiver() as receiver, sink(receiver.url.replace("http", "https")) as made:
        with pytest.raises(DeliveryError, match="cannot be reached"):
            made.deliver(events(1))
        assert not receiver.received
