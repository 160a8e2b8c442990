"""The command ``live``, which watches live data."""

from __future__ import annotations

import logging
import signal
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from residua.cli import screen
from residua.cli.guard import FAULT, NO_FAULT
from residua.cli.shared_options import check_file
from residua.cli.streams import complain
from residua.errors import DataError
from residua.monitor import Monitor
from residua.visible import echo, visible

if TYPE_CHECKING:
    from residua.live.config import LiveSettings
    from residua.live.run import Run


def live(
    config: Annotated[
        Path | None, typer.Argument(metavar="CONFIG.toml", help="Monitors, sources, store, sinks and page.")
    ] = None,
    check: Annotated[bool, typer.Option("--check", help="Check configuration and secrets, and stop.")] = False,
    reset: Annotated[
        str | None,
        typer.Option("--reset", metavar="PLANT", help="Restart a plant whose clock went back, and stop."),
    ] = None,
    example: Annotated[bool, typer.Option("--example", help="Print an example of a configuration, and stop.")] = False,
    demo: Annotated[bool, typer.Option("--demo", help="Watch three simulated plants; no configuration.")] = False,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="DIR", help="With --demo: folder for its files.")
    ] = None,
) -> None:
    """Watch live data: store alarms, send them on, show a page.

    It stops at Ctrl-C, or when all sources have ended: then with status 1 if an alarm was raised, else 0.
    """
    from residua.live import config as configuration

    if example:
        screen.say(configuration.example().rstrip())
        return
    if demo:
        _demo(config, output)
        return
    if config is None:
        raise typer.BadParameter("name a configuration; 'residua live --example' prints one", param_hint="CONFIG.toml")
    check_file(config, "configuration")
    settings = configuration.load_settings(config)
    if reset is not None:
        _reset(settings, reset)
        return
    configuration.check_secrets(settings)
    if check:
        _say(settings)
        return
    raise typer.Exit(_run(settings, linger=False))


def _say(settings: LiveSettings) -> None:
    """Print a summary of a configuration."""
    from residua.live.watched_model import WatchedModel

    for one in settings.monitors:
        WatchedModel(one.name, Monitor.load(one.file), settings.store.history)  # raises where the monitor cannot run
        more = " and new ones" if one.accept_new else ""
        screen.say(f"monitor {visible(one.name)}: {len(one.plants)} plants{more}")
    for what, some in (("source", settings.sources), ("sink", settings.sinks)):
        for kind, _ in some:
            screen.say(f"{what} {kind}")
    where = settings.store.file if settings.store.kind == "sqlite" else "PostgreSQL"
    screen.say(f"store {where}", f"page: {settings.server.listen if settings.server else 'none'}")


def _reset(settings: LiveSettings, plant: str) -> None:
    """Let the run that has the store, or the next one, restart a plant."""
    from residua.live.store import Changes, store_of

    store = store_of(settings.store)
    store.open(own=False)
    try:
        if all(one.plant != plant for one, _, _ in store.plants()):
            raise DataError(f"the store has no plant {echo(plant)}")
        store.commit(Changes(meta={f"reset {plant}": "asked"}))
    finally:
        store.close()
    screen.say(f"{visible(plant)} restarts with its next reading")


def _run(settings: LiveSettings, *, linger: bool) -> int:
    """Run until the sources have ended, or a signal arrives; return the exit status."""
    from residua.live.run import Run
    from residua.live.view import View

    with _logged():
        run = Run(settings)
        server = None
        try:
            if settings.server is not None:
                from residua.live.server import Server

                server = Server(View(run), settings.server)
            with _ended_by_signals(run) as stopped:
                run.work(lambda: _started(run, server))
                if linger and server is not None and not stopped.is_set():
                    screen.say("the data have ended; the page stays up; press Ctrl-C to stop")
                    stopped.wait()
        finally:
            if server is not None:
                server.stop()
            run.close()
        raised, rows = run.numbers.events["raised"], run.numbers.rows.total()
        screen.say(f"{rows:,} rows, {raised:,} alarms raised{_dropped(run)}")
        if stopped.is_set():
            return NO_FAULT
        if not run.watch.judged:
            raise DataError(f"no sample could be judged, so there is no verdict: {rows:,} rows read{_dropped(run)}")
        return FAULT if raised or any(one.reported for one in run.watch.plants.values()) else NO_FAULT


def _dropped(run: Run) -> str:
    """Return the numbers of unused messages and readings, by reason."""
    counts = {name: count for name, count in run.numbers.dropped.most_common() if name != "gap"}
    return f"; not used: {', '.join(f'{name} {count:,}' for name, count in counts.items())}" if counts else ""


def _started(run: Run, server: Any) -> None:
    if server is not None:
        server.start()
        given = run.settings.server.token_file or run.settings.server.token_env
        # A token of the user's own has no business in a log, which is where it goes unless somebody looks on.
        screen.say(f"page: {server.place if given and not sys.stdout.isatty() else server.address}")
    plants = len(run.watch.plants)
    watched = (
        f"watching {plants:,} plants{' and new ones' if run.takes_new else ''}" if plants else "waiting for plants"
    )
    screen.say(f"{watched}; press Ctrl-C to stop")
    sys.stdout.flush()


@contextmanager
def _ended_by_signals(run: Run) -> Iterator[threading.Event]:
    """Let SIGINT and SIGTERM shut a run down; yield an event that is set by then."""
    stopped = threading.Event()

    def stop() -> None:
        stopped.set()
        run.stop()

    def end(number: int, frame: FrameType | None) -> None:
        threading.Thread(target=stop).start()  # the interrupted thread may hold a lock that stopping needs

    before = {one: signal.signal(one, end) for one in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stopped
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


class _Lines(logging.Handler):
    """Handler that writes the log of a run to standard error, a line each."""

    def emit(self, record: logging.LogRecord) -> None:
        complain(f"{self.formatTime(record)} {record.levelname.lower()}: {visible(record.getMessage())}")

    @staticmethod
    def formatTime(record: logging.LogRecord) -> str:
        return logging.Formatter().formatTime(record, "%Y-%m-%d %H:%M:%S")


@contextmanager
def _logged() -> Iterator[None]:
    logger, lines = logging.getLogger("residua.live"), _Lines()
    level, above = logger.level, logger.propagate
    logger.addHandler(lines)
    logger.setLevel(logging.INFO)
    logger.propagate = False
    try:
        yield
    finally:
        logger.removeHandler(lines)
        logger.setLevel(level)
        logger.propagate = above


def _demo(config: Path | None, output: Path | None) -> None:
    from residua.demos import live as demo
    from residua.live.config import load_settings

    if config is not None:
        raise typer.BadParameter("the demo writes its own configuration: leave CONFIG.toml out", param_hint="--demo")
    folder = Path(tempfile.mkdtemp(prefix="residua-live-")) if output is None else output
    if folder.exists() and not folder.is_dir():
        raise DataError(f"{folder} is a file; name a folder")
    folder.mkdir(parents=True, exist_ok=True)
    path = demo.write(folder)
    screen.say(*demo.INTRODUCTION, f"configuration, recordings and store: {folder}")
    _run(load_settings(path), linger=True)
