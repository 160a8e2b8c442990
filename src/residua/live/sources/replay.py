"""A recording as live data: at a chosen speed, as one plant or as many."""

from __future__ import annotations

import heapq
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import ClassVar

import numpy as np
import orjson
from numpy.typing import NDArray

from residua.errors import ResiduaError, SettingError
from residua.live.setting_checks import check_types, choice, file, number, table_of_texts, texts, whole
from residua.live.source import Message
from residua.live.sources.adapter import ThreadedSource
from residua.plant import Plant
from residua.recording.columns import ReadOptions
from residua.recording.recording import read_recording
from residua.recording.streams import NotServedError, open_stream
from residua.recording.time_axis import seconds_since

#: Bytes of a file from which on it is read piece by piece.
_LARGE = 50_000_000
#: Rows of a message at most.
_MOST_ROWS = 10_000


@dataclass(frozen=True)
class Settings:
    """Settings of the recordings, and of the speed.

    Attributes
    ----------
    file : str
        The recording of all plants that have none of their own in ``files``.
    files : table
        The recordings of single plants, by their ids.
    plants : list of str
        The ids of the plants that are replayed; empty: those of ``files``, or without these all that are watched.
    speed : float
        Times as fast as it was recorded; 0: as fast as can be.
    rows : int
        Rows of a message.
    times : {"own", "now"}
        Those of the recording; or as if its first row had been taken when the replay began, and, after a restart, no
        earlier than the last row that the store has.
    repeat : int
        How often it is replayed, one after another in time; 0: for ever.
    column, dt, columns, fill_gaps
        As ``time``, ``dt``, ``columns`` and ``fill_gaps`` of :func:`residua.read_recording`.
    name : str
        Of the source; empty: ``"replay "`` and the name of the file.

    Raises
    ------
    SettingError
        If there is no such file, or none is named.
    """

    file: str = ""
    files: Mapping[str, str] = field(default_factory=dict)
    plants: tuple[str, ...] = ()
    speed: float = 1.0
    rows: int = 1
    times: str = "own"
    repeat: int = 1
    column: str = ""
    dt: float = 0.0
    columns: Mapping[str, str] = field(default_factory=dict)
    fill_gaps: bool = False
    name: str = ""

    def __post_init__(self) -> None:
        file(self, "file")
        for key in ("files", "columns"):
            object.__setattr__(self, key, table_of_texts(getattr(self, key), key))
        texts(self, "plants")
        number(self, "speed", 0.0)
        number(self, "dt", 0.0)
        whole(self, "rows", 1, _MOST_ROWS)
        whole(self, "repeat", 0, 10**9)
        choice(self, "times", ("own", "now"))
        check_types(self)
        if not self.file and not self.files:
            raise SettingError("file: name the recording that is replayed, or one for each plant in files")
        for plant, path in self.files.items():
            if not Path(path).is_file():
                raise SettingError(f"files: {path}, of {plant}, is not a file")


@dataclass(frozen=True, eq=False)
class _Track:
    """Plants that replay one file by one model: their messages differ in the id alone."""

    path: Path
    model: Plant
    plants: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Rows:
    """Some rows of a recording: seconds as in the file, and the origin of these, if they are dates."""

    times: NDArray[np.float64]
    u: NDArray[np.float64]
    y: NDArray[np.float64]
    origin: datetime | None


class Replay(ThreadedSource):
    """Source that brings the rows of recordings as messages.

    Parameters
    ----------
    settings : Settings
    models : mapping of str to Plant
        The plant of every id that may be replayed: by its channels the columns are found.

    Raises
    ------
    SettingError
        If a plant has no model, or no file.

    Notes
    -----
    With its own times it goes on after a restart where the store is; a row that the store has may come again with
    others of the same message. Files of 50 MB on are read piece by piece, where :meth:`residua.Monitor.run_file` does.
    """

    kind: ClassVar[str] = "replay"
    finite = True
    rereads = True

    def __init__(self, settings: Settings, models: Mapping[str, Plant]) -> None:
        paths = [settings.file] if settings.file else list(settings.files.values())
        super().__init__(settings.name or f"replay {Path(paths[0]).name}")
        self._settings = settings
        self._tracks = _tracks(settings, models)
        self._reached: Mapping[str, float] = {}

    def resume(self, times: Mapping[str, float]) -> None:
        """Continue after these times, if they are the recording's own; with others, no earlier than the last one."""
        self._reached = dict(times)

    def work(self) -> None:
        """Put all rows, each when it is due: the first at once, the others at a multiple of the recorded speed."""
        settings = self._settings
        names = ", ".join(dict.fromkeys(track.path.name for track in self._tracks))
        self.say(True, f"replays {names}")
        messages, begin = 0, None
        origin = datetime.now(UTC)
        if settings.times == "now" and self._reached:
            latest = datetime.fromtimestamp(max(self._reached.values()), UTC)
            origin = max(origin, latest + timedelta(seconds=max(track.model.dt for track in self._tracks)))
        try:
            for elapsed, track, rows in heapq.merge(*map(self._due, self._tracks), key=lambda one: one[0]):
                if settings.times == "now":
                    rows = _Rows(elapsed - (rows.times[-1] - rows.times), rows.u, rows.y, origin)
                last = float(rows.times[-1]) + (rows.origin.timestamp() if rows.origin else 0.0)
                plants = [plant for plant in track.plants if not last <= self._reached.get(plant, -np.inf)]
                if not plants:
                    continue
                if settings.speed:
                    due, now = elapsed / settings.speed, time.monotonic()
                    begin = now - due if begin is None else begin
                    self.stopping.wait(max(0.0, begin + due - now))
                if self.stopping.is_set():
                    return
                body = _body(rows)
                for plant in plants:
                    self.put(Message(self, b'{"plant":' + orjson.dumps(plant) + b"," + body, time.time()))
                    messages += 1
            self.say(True, f"has ended, after {messages:,} messages of {names}")
        except (ResiduaError, NotServedError, OSError) as error:
            self.say(False, f"cannot go on: {error}")

    def _due(self, track: _Track) -> Iterator[tuple[float, _Track, _Rows]]:
        """Return blocks of rows, each with the time since the beginning at which its last row is due."""
        shift, rounds = 0.0, 0
        while self._settings.repeat == 0 or rounds < self._settings.repeat:
            first = last = before = None
            for rows in _read(track, self._settings):
                for k in range(0, len(rows.times), self._settings.rows):
                    part = slice(k, k + self._settings.rows)
                    times = rows.times[part] + shift if shift else rows.times[part]
                    first = float(times[0]) - shift if first is None else first
                    before = last if len(times) < 2 else float(times[-2])
                    last = float(times[-1])
                    yield last - first, track, _Rows(times, rows.u[part], rows.y[part], rows.origin)
            if first is None or last is None:
                return
            step = track.model.dt or (last - before if before is not None else 1.0)
            shift, rounds = last + step - first, rounds + 1


def _tracks(settings: Settings, models: Mapping[str, Plant]) -> list[_Track]:
    plants = settings.plants or (tuple(settings.files) if settings.files and not settings.file else tuple(models))
    groups: dict[tuple[str, int], list[str]] = {}
    for plant in plants:
        path = settings.files.get(plant, settings.file)
        if plant not in models:
            raise SettingError(f"plants: {plant} is not watched")
        if not path:
            raise SettingError(f"files: there is no recording of {plant}")
        groups.setdefault((path, id(models[plant])), []).append(plant)
    return [_Track(Path(path), models[ids[0]], tuple(ids)) for (path, _), ids in groups.items()]


# ------------------------------------------------------------------ reading


def _read(track: _Track, settings: Settings) -> Iterator[_Rows]:
    """Read a recording: piece by piece if it is large and allows it."""
    done = 0
    if track.path.stat().st_size >= _LARGE:
        try:
            for rows in _pieces(track, settings):
                done += len(rows.times)
                yield rows
            return
        except NotServedError:  # it is read at once, which reports any error
            pass
    recording = read_recording(
        track.path,
        track.model,
        time=settings.column or None,
        dt=settings.dt or None,
        columns=settings.columns or None,
        fill_gaps=settings.fill_gaps,
    )
    yield _Rows(recording.time[done:], recording.u[done:], recording.y[done:], _moment(recording.origin))


def _pieces(track: _Track, settings: Settings) -> Iterator[_Rows]:
    options = ReadOptions(
        track.model,
        settings.column or None,
        settings.dt or None,
        settings.columns or None,
        None,
        fill_gaps=settings.fill_gaps,
    )
    stream = open_stream(track.path, options)
    done, first = 0, None
    for piece in stream.pieces():
        rows, times, origin = len(piece.values), piece.time, None
        if times is None:
            times = np.arange(done, done + rows, dtype=np.float64) * (options.step or 1.0)
        elif times.dtype.kind == "M":
            first = times[0] if first is None else first
            times, origin = seconds_since(times, first), _moment(str(np.datetime_as_string(first, unit="auto")))
        yield _Rows(times, piece.values[:, : stream.inputs], piece.values[:, stream.inputs :], origin)
        done += rows


def _moment(origin: str) -> datetime | None:
    """Return the origin of times; without a zone it is taken as UTC."""
    if not origin:
        return None
    moment = datetime.fromisoformat(origin.strip()[:32])
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)


def _body(rows: _Rows) -> bytes:
    """Return the message of rows as JSON, without the plant and the bracket before it; floats to their last bit."""
    times = rows.times.tolist()
    if rows.origin is not None:
        times = [(rows.origin + timedelta(seconds=one)).isoformat() for one in times]
    content = {"t": times, "u": rows.u, "y": rows.y}
    if len(times) == 1:
        content = {name: values[0] for name, values in content.items()}
    return orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY, default=np.ndarray.tolist)[1:]


__all__ = ["Replay", "Settings"]
