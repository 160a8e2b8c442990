"""Monitors by operating mode as JSON: the switch, and the monitor of every mode as in a file of its own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from residua.errors import FileFormatError, ResiduaError
from residua.files import other_version, read_bytes, write_text
from residua.identify.regimes import ModeSignals, OperatingMode, Regimes, mode_signals
from residua.json_files import CHECKSUM, check_checksum, dumps, loads
from residua.monitor.monitor import Monitor
from residua.monitor.regime_monitor import SAME_STEP, RegimeMonitor
from residua.monitor.saving import EDITED, REGIMES, monitor_from, monitor_out
from residua.number_kinds import POSITIVE
from residua.records import (
    float_in,
    float_out,
    joined,
    list_in,
    record,
    table_in,
    text_in,
    texts_in,
    whole_in,
)
from residua.visible import echo, listed, shortened

VERSION = 1
_ENTRIES = (
    *("format", "version", "by", "inputs", "outputs", "dt", "without_model", "unfitted", "notes", "modes"),
    CHECKSUM,
)
_MODE = ("key", "samples", "transient", "still", "monitor")


def save_regimes(monitor: RegimeMonitor, path: str | Path) -> None:
    """Write a monitor by operating mode; the file appears whole or not at all."""
    regimes = monitor.regimes
    signals = regimes.signals
    content = {
        "format": REGIMES,
        "version": VERSION,
        "by": [[name, None if e is None else list(e)] for name, e in zip(signals.names, signals.edges, strict=True)],
        "inputs": list(regimes.inputs),
        "outputs": list(regimes.outputs),
        "dt": float_out(regimes.dt),
        "without_model": dict(regimes.without_model),
        "unfitted": dict(monitor.unfitted),
        "notes": list(regimes.notes),
        "modes": [
            {
                "key": list(mode.key),
                "samples": int(mode.samples),
                "transient": int(mode.transient),
                "still": list(mode.still),
                "monitor": monitor_out(monitor.monitors[name]),
            }
            for name, mode in regimes.modes.items()
        ],
    }
    write_text(path, dumps(content))


def load_regimes(path: str | Path) -> RegimeMonitor:
    """Read a monitor by operating mode; :class:`FileFormatError` names the wrong entry."""
    path = Path(path)
    content = loads(read_bytes(path, "monitor"), path.name)
    if content.get("format") != REGIMES:
        raise FileFormatError(f'{path.name} is not a monitor by operating mode (no "format": {REGIMES!r} in it)')
    if content.get("version") != VERSION:
        raise FileFormatError(
            other_version(path.name, content.get("version"), VERSION, "design and fit the monitor again")
        )
    edited = not check_checksum(content, path.name)
    try:
        made = _made(record(content, "", _ENTRIES))
    except (TypeError, ValueError, AttributeError, LookupError, ArithmeticError, MemoryError, ResiduaError) as error:
        raise FileFormatError(f"{path.name}: {shortened(str(error), 1000)}") from error
    if edited:
        for one in made.monitors.values():
            one.notes = (*one.notes, EDITED)
    return made


def _made(content: Mapping[str, Any]) -> RegimeMonitor:
    signals = _signals(content["by"])
    inputs, outputs = texts_in(content["inputs"], "inputs"), texts_in(content["outputs"], "outputs")
    dt = float_in(content["dt"], "dt", POSITIVE)
    absent = [name for name in signals.names if name not in inputs + outputs]
    if absent:
        raise FileFormatError(f"by: {listed(absent)} is not among the inputs and outputs")
    modes: dict[str, OperatingMode] = {}
    monitors: dict[str, Monitor] = {}
    for k, entry in enumerate(list_in(content["modes"], "modes")):
        where = joined("modes", k)
        one = record(entry, where, _MODE)
        where_key = joined(where, "key")
        key = tuple(float_in(value, where_key) for value in list_in(one["key"], where_key, len(signals.names)))
        name = signals.label(key)
        if name in modes:
            raise FileFormatError(f"{where}: the mode {echo(name)} occurs twice")
        monitor = monitor_from(
            {**table_in(one["monitor"], joined(where, "monitor")), CHECKSUM: None}, joined(where, "monitor")
        )
        plant = monitor.design.plant
        foreign = [c for c in (*plant.inputs, *plant.outputs) if c not in inputs + outputs]
        if foreign or abs(monitor.generator.dt - dt) > SAME_STEP * dt:
            raise FileFormatError(
                f"{where}.monitor: its channels must be among the inputs and outputs, and its step {dt:g} s; got "
                f"{listed(foreign) if foreign else f'{monitor.generator.dt:g} s'}"
            )
        modes[name] = OperatingMode(
            key,
            name,
            monitor.design,
            whole_in(one["samples"], joined(where, "samples")),
            whole_in(one["transient"], joined(where, "transient")),
            texts_in(one["still"], joined(where, "still")),
        )
        monitors[name] = monitor
    without, unfitted = (_texts(content[what], what) for what in ("without_model", "unfitted"))
    regimes = Regimes(signals, modes, without, inputs, outputs, dt, texts_in(content["notes"], "notes"))
    return RegimeMonitor.of(regimes, monitors, unfitted)


def _signals(value: Any) -> ModeSignals:
    pairs = [list_in(one, joined("by", k), 2) for k, one in enumerate(list_in(value, "by"))]
    return mode_signals({text_in(name, "by"): edges for name, edges in pairs})


def _texts(value: Any, where: str) -> dict[str, str]:
    return {name: text_in(text, joined(where, name)) for name, text in table_in(value, where).items()}


__all__ = ["VERSION", "load_regimes", "save_regimes"]
