"""Events to a web address: each one a signed POST."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import hmac
import threading
import time
from dataclasses import dataclass
from ipaddress import ip_address
from typing import ClassVar

import httpx

from residua.errors import SettingError
from residua.live.delivery import DeliveryError, OneByOne, RefusedError
from residua.live.events import Event
from residua.live.secrets import check_secret, secret, tls_context
from residua.live.setting_checks import check_types, seconds
from residua.visible import echo

#: The header with the signature.
SIGNATURE = "Residua-Signature"
#: Answers that say that the receiver cannot take anything now; all from 500 on do too.
AWAY = frozenset({408, 409, 421, 425, 429})
#: Answers that are about this event, and would be the same for ever; others (401, 404, ...) are about the address.
REFUSED = frozenset({400, 413, 415, 422})
#: Characters of a key, at least.
SHORTEST_KEY = 16


@dataclass(frozen=True)
class Settings:
    """Settings of the address, and of signatures.

    Attributes
    ----------
    url, url_file, url_env : str
        The address; out of a file or an environment variable where whoever knows it may send. HTTPS, except on this
        machine itself.
    key_file, key_env : str
        The key that events are signed with.
    unsigned : bool
        Whether there is no key, and no signature.
    token_file, token_env : str
        Sent as ``Authorization: Bearer``, where the receiver wants that.
    timeout : float
        Seconds that a delivery may take, all in all.
    drop_refused : bool
        Whether an event that the receiver refuses for good (400, 413, 415, 422) is given up; otherwise it is tried
        again, for ever, and those after it wait.
    ca_file : str
        Certificates of a certification authority of your own; empty: the usual ones.
    proxy : str
        The address of a proxy; empty: none, whatever the environment says.
    name : str
        Of the sink; empty: ``"webhook "`` and scheme, host and port of the address.

    Raises
    ------
    SettingError
    """

    url: str = ""
    url_file: str = ""
    url_env: str = ""
    key_file: str = ""
    key_env: str = ""
    unsigned: bool = False
    token_file: str = ""
    token_env: str = ""
    timeout: float = 10.0
    drop_refused: bool = False
    ca_file: str = ""
    proxy: str = ""
    name: str = ""

    def __post_init__(self) -> None:
        check_types(self)
        seconds(self, "timeout")
        for name in ("url", "key", "token"):
            check_secret(self, name)
        if sum(map(bool, (self.url, self.url_file, self.url_env))) != 1:
            raise SettingError("url: just one of url, url_file and url_env says where events are sent")
        if self.url:
            checked_address(self.url, "url")
        if self.unsigned == bool(self.key_file or self.key_env):
            raise SettingError(
                "key_file or key_env: the key that events are signed with; or unsigned = true, and no key"
            )
        if self.proxy:
            _parsed(self.proxy, "proxy")


def checked_address(text: str, key: str) -> httpx.URL:
    """Return an address if events may be sent to it.

    Raises
    ------
    SettingError
        If it is not an address, has a user or a password in it, or is neither HTTPS nor on this machine.

    Examples
    --------
    >>> checked_address("https://alarms.example.org/residua", "url").host
    'alarms.example.org'
    >>> checked_address("http://alarms.example.org/residua", "url")
    Traceback (most recent call last):
    ...
    residua.errors.SettingError: url: https is needed to reach alarms.example.org; http only on this machine itself
    """
    url = _parsed(text, key)
    if url.scheme == "http" and not on_this_machine(url.host):
        raise SettingError(f"{key}: https is needed to reach {url.host}; http only on this machine itself")
    return url


def _parsed(text: str, key: str) -> httpx.URL:
    try:
        url = httpx.URL(text)
    except (httpx.InvalidURL, TypeError):
        raise SettingError(f"{key}: it is not a web address") from None
    if url.scheme not in ("http", "https") or not url.host:
        raise SettingError(f"{key}: an address begins with https:// and a host")
    if url.userinfo:
        raise SettingError(f"{key}: no user or password in an address; token_file and token_env are for such")
    return url


def on_this_machine(host: str) -> bool:
    """Tell whether a host is this machine by its name or number alone.

    Examples
    --------
    >>> [on_this_machine(host) for host in ("localhost", "127.0.0.1", "::1", "localhost.example.org", "10.0.0.1")]
    [True, True, True, False, False]
    """
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


def signature(key: str, body: bytes, timestamp: int) -> str:
    r"""Return the value of the header that signs a body.

    ``t=<timestamp>,v1=<signature>``: the signature is HMAC-SHA256, in hexadecimal, with the key as UTF-8, of the
    timestamp in decimal (seconds since 1970), a full stop, and the body.

    Examples
    --------
    >>> signature("a key of the plant", b'{"plant": "north"}', 1_800_000_000)
    't=1800000000,v1=ee468f01d45180676260bb53101e1d65f4bb4de0cc71ad2eea03a288e10e5cd3'
    """
    signed = hmac.new(key.encode(), f"{timestamp}.".encode() + body, hashlib.sha256).hexdigest()
    return f"t={timestamp},v1={signed}"


class Webhook(OneByOne):
    """Sink that sends each event as one POST of its JSON; any answer from 200 to 299 means delivered.

    Redirects are not followed, the environment (proxies, passwords in ``.netrc``) is not looked at, and of the answer
    only the status is read. See :func:`signature` for how a receiver knows that it comes from here.

    Parameters
    ----------
    settings : Settings

    Raises
    ------
    SettingError
        If a secret or the certificates cannot be read, or the key is too short.
    """

    kind: ClassVar[str] = "webhook"

    def __init__(self, settings: Settings) -> None:
        self._settings, self.drop_refused = settings, settings.drop_refused
        key = "url" if settings.url else "url_file" if settings.url_file else "url_env"
        self._url = checked_address(settings.url or secret(settings, "url") or "", key)
        self._where = f"{self._url.scheme}://{self._url.netloc.decode('ascii')}"
        self.name = settings.name or f"webhook {self._where}"
        self._key = secret(settings, "key")
        if self._key is not None and len(self._key) < SHORTEST_KEY:
            raise SettingError(f"key: {len(self._key)} characters can be guessed; at least {SHORTEST_KEY}")
        self._headers = {"Content-Type": "application/json", "User-Agent": "residua"}
        token = secret(settings, "token")
        if token is not None:
            if not token.isascii() or " " in token:
                raise SettingError("token: a token for a header has ASCII characters only, and no blanks")
            self._headers["Authorization"] = f"Bearer {token}"
        self._runner, self._sending = asyncio.Runner(), threading.Lock()
        self._task: asyncio.Task[int] | None = None
        self._closed = False
        self._client = httpx.AsyncClient(
            verify=tls_context(settings) if settings.ca_file else True,
            proxy=settings.proxy or None,
            trust_env=False,
            follow_redirects=False,
            timeout=settings.timeout,
        )

    def send(self, event: Event) -> None:
        """Send an event.

        Raises
        ------
        DeliveryError
            If there was no connection, no answer in time, or an answer from 300 on.
        """
        with self._sending:
            if self._closed:
                raise DeliveryError("the run is ending")
            try:
                status = self._runner.run(self._post(event.to_json().encode()))
            except asyncio.CancelledError:
                raise DeliveryError("the run is ending") from None
            finally:
                self._task = None
        if status in REFUSED:
            raise RefusedError(f"{self._where} refuses the event ({status}); drop_refused = true goes on without it")
        if not 200 <= status < 300:
            raise DeliveryError(f"{self._where} {_meaning(status)}")

    async def _post(self, body: bytes) -> int:
        """Send a body, and return the status of the answer."""
        self._task = asyncio.current_task()
        headers = dict(self._headers)
        if self._key is not None:
            headers[SIGNATURE] = signature(self._key, body, int(time.time()))
        try:
            # All in all: a receiver that sends its answer byte by byte is away as well.
            async with asyncio.timeout(self._settings.timeout):
                async with self._client.stream("POST", self._url, content=body, headers=headers) as answer:
                    return answer.status_code
        except (TimeoutError, httpx.TimeoutException):
            raise DeliveryError(f"{self._where} gave no answer within {self._settings.timeout:g} s") from None
        except httpx.ConnectError as error:
            raise DeliveryError(f"{self._where} cannot be reached: {echo(str(error))}") from None
        except httpx.HTTPError as error:  # its text may have headers in it
            raise DeliveryError(f"{self._where}: the connection failed ({type(error).__name__})") from None

    def close(self) -> None:
        """Close the connections, and abandon the current delivery."""
        self._closed, task = True, self._task
        if task is not None:
            with contextlib.suppress(RuntimeError):  # it has just ended
                task.get_loop().call_soon_threadsafe(task.cancel)
        with self._sending:
            self._runner.run(self._client.aclose())
            self._runner.close()


def _meaning(status: int) -> str:
    """Return the meaning of the status of an answer, with a remedy."""
    if status < 400:
        return f"answers with a redirect ({status}), which is not followed: set its address"
    if status in (401, 403):
        return f"does not let this sink in ({status}): look at its key and token"
    if status in AWAY or status >= 500:
        return f"cannot take the event now ({status})"
    return f"answers with {status}: look at the address"
