"""The configuration of a run: one TOML file, checked as a whole before anything is opened."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import Any

from residua.errors import FileFormatError, MissingExtraError, SettingError
from residua.files import read_bytes
from residua.live.secrets import secret
from residua.live.setting_checks import check_types, choice, needed, number, seconds, texts, whole
from residua.live.source import LONGEST_ID
from residua.visible import echo, listed

#: Sources and sinks by their kind: the module, which has ``Settings``, and the class that they make.
SOURCES = {
    "mqtt": ("residua.live.sources.mqtt", "Mqtt"),
    "opcua": ("residua.live.sources.opcua", "OpcUa"),
    "kafka": ("residua.live.sources.kafka", "Kafka"),
    "stdin": ("residua.live.sources.stdin", "JsonLines"),
    "replay": ("residua.live.sources.replay", "Replay"),
}
SINKS = {
    "webhook": ("residua.live.sinks.webhook", "Webhook"),
    "mqtt": ("residua.live.sinks.mqtt", "Mqtt"),
    "jsonl": ("residua.live.sinks.jsonl", "JsonLines"),
    "command": ("residua.live.sinks.command", "Command"),
}
_SERVER = "residua.live.server"
#: Keys that are paths: taken from the folder of the configuration where they are relative.
_PATHS = ("file", "path", "files")
_LARGEST = 10_000_000
#: Plants of a monitor, and seconds of any time, at most.
_MOST_PLANTS, _LONGEST = 10_000_000, 1e8


@dataclass(frozen=True)
class MonitorSettings:
    """A monitor, and the plants that it watches.

    Attributes
    ----------
    file : str
        File written by ``residua fit`` or ``learn``.
    name : str
        Of the model, on the page and in the metrics; empty: the name of the file.
    plants : list of str
        The ids of its plants.
    accept_new : bool
        Whether plants that are not listed are taken in when they send; of one monitor only.
    max_plants : int, default 10,000
        Plants of this monitor at most.
    """

    file: str
    name: str = ""
    plants: tuple[str, ...] = ()
    accept_new: bool = False
    max_plants: int = 10_000

    def __post_init__(self) -> None:
        needed(self, "file", "the monitor, such as 'tank.json'")
        texts(self, "plants")
        for plant in self.plants:
            _check(len(plant) <= LONGEST_ID, f"plants: an id has at most {LONGEST_ID} characters")
        whole(self, "max_plants", 1, _MOST_PLANTS)
        check_types(self)
        _check(len(self.plants) <= self.max_plants, f"max_plants: {len(self.plants)} plants are listed")
        _check(bool(self.plants) or self.accept_new, "plants: name the plants, or set accept_new = true")
        object.__setattr__(self, "name", self.name or Path(self.file).stem)


@dataclass(frozen=True)
class SamplingOptions:
    """Options for the conversion of readings to rows.

    Attributes
    ----------
    wait : float, default 2
        Seconds that a row waits for readings that are missing.
    max_age : float, default 0
        Seconds for which a channel that is not stated keeps its last value; 0: it is missing at once.
    silence : float, default 60
        Seconds without anything of a plant after which its data are said to be missing.
    """

    wait: float = 2.0
    max_age: float = 0.0
    silence: float = 60.0

    def __post_init__(self) -> None:
        for name in ("wait", "max_age", "silence"):
            number(self, name, 0.0, _LONGEST)
        seconds(self, "silence")


@dataclass(frozen=True)
class StoreSettings:
    """Options of the store, where a run keeps everything it must not lose.

    Attributes
    ----------
    kind : {"sqlite", "postgresql"}
    file : str
        Of SQLite.
    dsn_file, dsn_env : str
        Of PostgreSQL: a file or an environment variable with the connection string.
    history : float, default 3600
        Seconds of rows that are kept of each plant at least.
    keep_events : int, default 100,000
        Events that are kept at least, once all sinks have delivered them.
    """

    kind: str = "sqlite"
    file: str = ""
    dsn_file: str = ""
    dsn_env: str = ""
    history: float = 3600.0
    keep_events: int = 100_000

    def __post_init__(self) -> None:
        choice(self, "kind", ("sqlite", "postgresql"))
        check_types(self)
        if self.kind == "sqlite":
            _check(bool(self.file), "file: the file of the store, such as 'live.db'")
            _check(not (self.dsn_file or self.dsn_env), "dsn_file: it is for PostgreSQL: kind = 'postgresql'")
        else:
            _check(not self.file, "file: it is for SQLite; PostgreSQL has dsn_file or dsn_env")
            _check(bool(self.dsn_file) != bool(self.dsn_env), "dsn_file: either dsn_file or dsn_env")
        number(self, "history", 0.0, _LONGEST)
        seconds(self, "history")
        whole(self, "keep_events", 1000, 10**12)


@dataclass(frozen=True)
class LiveSettings:
    """All settings of a run.

    Attributes
    ----------
    monitors : tuple of MonitorSettings
    sampling : SamplingOptions
    store : StoreSettings
    sources, sinks : tuple of (str, settings)
        Kind, and the settings of the adapter.
    server : settings or None
        ``None``: no page.
    """

    monitors: tuple[MonitorSettings, ...]
    store: StoreSettings
    sources: tuple[tuple[str, Any], ...]
    sampling: SamplingOptions = field(default_factory=SamplingOptions)
    sinks: tuple[tuple[str, Any], ...] = ()
    server: Any = None


def _check(good: bool, text: str) -> None:
    if not good:
        raise SettingError(text)


# ------------------------------------------------------------------------------ reading


def load_settings(path: str | Path) -> LiveSettings:
    """Read a configuration.

    Parameters
    ----------
    path : str or Path
        TOML, read as data alone. Paths in it are taken from its folder.

    Raises
    ------
    FileFormatError
        If it is not TOML, or a key is unknown, missing, or invalid: one line with the key and its line.
    MissingExtraError
        If a package that an adapter needs is not installed.
    """
    path = Path(path)
    content = read_bytes(path, "configuration")
    if len(content) > _LARGEST:
        raise FileFormatError(f"{path}: this is too large for a configuration")
    try:
        words = content.decode("utf-8")
        tables = tomllib.loads(words)
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise FileFormatError(f"{path}: no TOML: {error}") from error
    return _Reader(path, words).settings(tables)


class _Reader:
    """Reader of the tables of a configuration; errors name the line."""

    def __init__(self, path: Path, text: str) -> None:
        self.path, self.lines, self.folder = path, text.splitlines(), path.parent

    def settings(self, whole: dict[str, Any]) -> LiveSettings:
        tables = ("monitors", "sampling", "store", "sources", "sinks", "server")
        for name in whole:
            if name not in tables:
                self._fail("", 0, name, f"unknown; there are {listed(list(tables))}{_meant(name, tables)}")
        monitors = tuple(
            self._table(one, "monitors", k, MonitorSettings) for k, one in enumerate(self._list(whole, "monitors"))
        )
        if not monitors:
            raise FileFormatError(f"{self.path}: name at least one monitor: [[monitors]] with file and plants")
        self._check_monitors(monitors)
        store = self._table(whole.get("store", {}), "store", 0, StoreSettings)
        sampling = self._table(whole.get("sampling", {}), "sampling", 0, SamplingOptions)
        sources = self._adapters(whole, "sources", SOURCES)
        if not sources:
            raise FileFormatError(f"{self.path}: name at least one source: [[sources]] with its kind")
        sinks = self._adapters(whole, "sinks", SINKS)
        server = None
        if "server" in whole:
            server = self._table(whole["server"], "server", 0, self._settings_of(_SERVER, "server", 0))
        return LiveSettings(monitors, store, sources, sampling, sinks, server)

    def _check_monitors(self, monitors: Sequence[MonitorSettings]) -> None:
        seen: dict[str, int] = {}
        names: set[str] = set()
        for k, one in enumerate(monitors):
            if one.name in names:
                self._fail("monitors", k, "name", f"there is another monitor {echo(one.name)}: name one of them")
            names.add(one.name)
            for plant in one.plants:
                if seen.setdefault(plant, k) != k:
                    self._fail("monitors", k, "plants", f"the plant {echo(plant)} has another monitor already")
            if one.accept_new and any(other.accept_new for other in monitors[:k]):
                self._fail("monitors", k, "accept_new", "another monitor takes in new plants already")

    def _list(self, whole: dict[str, Any], name: str) -> list[dict[str, Any]]:
        """Return the tables of a name, none if it is absent."""
        content = whole.get(name, [])
        if not isinstance(content, list) or not all(isinstance(one, dict) for one in content):
            self._fail("", 0, name, f"must be tables, [[{name}]]")
        return content

    def _adapters(self, whole: dict[str, Any], name: str, kinds: Mapping[str, tuple[str, str]]) -> tuple[Any, ...]:
        out = []
        for k, one in enumerate(self._list(whole, name)):
            kind = one.get("kind")
            if not isinstance(kind, str) or kind not in kinds:
                found = "missing" if kind is None else f"unknown: {echo(kind)}"
                self._fail(name, k, "kind", f"{found}; there are {listed(list(kinds))}")
            rest = {key: value for key, value in one.items() if key != "kind"}
            out.append((kind, self._table(rest, name, k, self._settings_of(kinds[str(kind)][0], name, k))))
        return tuple(out)

    def _settings_of(self, module: str, table: str, number: int) -> Any:
        try:
            return import_module(module).Settings
        except MissingExtraError as error:
            raise MissingExtraError(f"{self.path}, line {self._line(table, number, 'kind')}: {error}") from error

    def _table(self, content: Any, table: str, number: int, kind: Any) -> Any:
        """Return the settings of a table."""
        if not isinstance(content, dict):
            self._fail("", 0, table, f"must be a table, [{table}]")
        known = {one.name: one for one in fields(kind)}
        for key in content:
            if key not in known:
                bare = f"{key}_file" in known or f"{key}_env" in known
                hint = f"; secrets come from {key}_file or {key}_env" if bare else _meant(key, known)
                self._fail(table, number, key, f"unknown{hint}")
        for key, one in known.items():
            if key not in content and one.default is MISSING and one.default_factory is MISSING:
                self._fail(table, number, key, "missing")
        try:
            return kind(**{key: self._placed(key, value) for key, value in content.items()})
        except (SettingError, TypeError, ValueError) as error:
            text = str(error)
            key = next((key for key in re.split(r"[^\w]+", text) if key in known), "")
            self._fail(table, number, key, text.removeprefix(f"{key}: "))

    def _placed(self, key: str, value: Any) -> Any:
        """Return a value, with paths relative to the folder of the configuration."""
        if isinstance(value, list) and all(isinstance(one, str) for one in value):
            return tuple(value)
        if key not in _PATHS and not key.endswith("_file"):
            return value
        if isinstance(value, str) and value:
            return str(self.folder / value)
        if isinstance(value, dict):
            return {name: self._placed(key, one) for name, one in value.items()}
        return value

    def _fail(self, table: str, number: int, key: str, text: str) -> Any:
        where = f"{table}.{key}" if table and key else table or key
        raise FileFormatError(f"{self.path}, line {self._line(table, number, key)}: {where}: {text}")

    def _line(self, table: str, number: int, key: str) -> int:
        """Return the line of a key, or else that of its table."""
        here, seen, last = "" if table else None, -1, 1
        for k, line in enumerate(self.lines, 1):
            head = re.match(r"\s*\[\[?\s*([\w.\"'-]+)\s*\]\]?", line)
            if head:
                name = head.group(1).split(".")[0].strip("\"'")
                inner = "." in head.group(1)
                if name == table and not inner:
                    seen += 1
                here = name if name == table and seen == number else None
                if (here is not None and not inner) or (not table and name == key):
                    last = k
                    if not table:
                        return k
                continue
            if (here is not None) and re.match(rf"\s*[\"']?{re.escape(key)}[\"']?\s*[.=]", line) and key:
                return k
        return last


def _meant(name: str, known: Any) -> str:
    near = get_close_matches(name, list(known), 1)
    return f"; did you mean {near[0]}?" if near else ""


def adapter(kind: str, settings: Any, kinds: Mapping[str, tuple[str, str]], *more: Any) -> Any:
    """Return the source or sink of some settings."""
    module, name = kinds[kind]
    return getattr(import_module(module), name)(settings, *more)


def check_secrets(settings: LiveSettings) -> None:
    """Check that the secrets in settings can be read, without keeping any, before anything is opened.

    Raises
    ------
    SettingError
        If one cannot be had; the text says of which table, and has no secret in it.
    """
    tables = [*((f"source {kind}", one) for kind, one in settings.sources), ("store", settings.store)]
    tables += [(f"sink {kind}", one) for kind, one in settings.sinks]
    tables += [("server", settings.server)] if settings.server is not None else []
    for where, one in tables:
        names = [key.name.removesuffix("_env") for key in fields(one) if key.name.endswith("_env")]
        for name in names:
            try:
                secret(one, name)
            except SettingError as error:
                raise SettingError(f"{where}: {error}") from error


def example() -> str:
    """Return a configuration to start from."""
    return _EXAMPLE


_EXAMPLE = """\
# residua live: what is watched, where data come from, where alarms go. Times are in seconds.

[[monitors]]
file = "tank.json"                      # written by residua fit or learn
plants = ["north", "south"]             # or accept_new = true

[[sources]]
kind = "mqtt"
client_id = "residua-tanks"
topics = ["plants/{plant}/data"]

[sampling]
wait = 2.0                              # for readings that are late

[store]
kind = "sqlite"
file = "live.db"

[[sinks]]
kind = "jsonl"
path = "alarms.jsonl"

[server]
listen = "127.0.0.1:8000"
"""

__all__ = [
    "SINKS",
    "SOURCES",
    "LiveSettings",
    "MonitorSettings",
    "SamplingOptions",
    "StoreSettings",
    "adapter",
    "check_secrets",
    "example",
    "load_settings",
]
