"""Plant files: a plant described in TOML. Read, checked, never executed."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError, FileFormatError, ModelError
from residua.files import read_bytes
from residua.number_kinds import kind_of
from residua.plant.channels import FAULT_NOTES, OperatingPoint
from residua.plant.identification import Identification
from residua.plant.plant import Plant
from residua.plant.toml_entry import Entry, suggestion
from residua.visible import echo, listed, shortened

_VERSION = 1
FORMAT = f"residua-plant/{_VERSION}"

FILE_KEYS = (
    "format",
    "name",
    "description",
    "dt",
    "sample_time",
    "states",
    "inputs",
    "outputs",
    "matrices",
    "identification",
    "disturbances",
    "faults",
    "noise",
)
IDENTIFICATION_KEYS = ("method", "rows", "coloured", "weak_inputs", "uncertain_gains")
CHANNEL_KEYS = ("names", "units", "operating_point")
FAULT_KEYS = ("name", "kind", "component", "input", "output", "state", *FAULT_NOTES)
KINDS = ("actuator", "sensor", "component")


def load_plant(path: str | Path) -> Plant:
    """Read a plant file.

    The file is TOML and is only ever read as data. Its entries are described in the page "Plant files" of
    the documentation.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Plant

    Raises
    ------
    FileFormatError
        If there is no such file, it is not TOML (the message has line and column), an entry is missing, unknown,
        of the wrong shape or not finite (the message names the entry), or the plant it describes is not valid.

    Examples
    --------
    >>> from residua.plant import load_plant
    >>> load_plant("no_such_plant.toml")
    Traceback (most recent call last):
        ...
    residua.errors.FileFormatError: no_such_plant.toml: plant file not found
    """
    path = Path(path)
    try:
        text = read_bytes(path, "plant file").decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path.name}: not a text file in UTF-8 (byte {error.start})") from error
    return loads_plant(text, source=path.name)


def loads_plant(text: str, *, source: str = "plant") -> Plant:
    """Make a plant from the text of a plant file; see :func:`load_plant`.

    Parameters
    ----------
    text : str
    source : str
        Name of the file in error messages.

    Returns
    -------
    Plant

    Examples
    --------
    >>> from residua.plant import loads_plant
    >>> lag = loads_plant('''
    ... format = "residua-plant/1"
    ... name = "lag"
    ... matrices = {A = [[-1]], B = [[1]], C = [[1]]}
    ... faults = [{kind = "sensor", output = "y1"}]
    ... ''')
    >>> lag.faults
    ('y1 sensor',)
    """
    try:
        data = tomllib.loads(text)
    except ValueError as error:  # also whole numbers without end, and dates that are none
        raise FileFormatError(f"{source}: not valid TOML: {shortened(str(error))}") from error
    except RecursionError as error:
        raise FileFormatError(f"{source}: not valid TOML: nested too deeply") from error
    if "format" not in data:
        raise FileFormatError(f'{source}: not a plant file: it must say format = "{FORMAT}"')
    root = Entry(data, source, "", FILE_KEYS)
    if root.data["format"] != FORMAT:
        found = root.data["format"]
        named = re.fullmatch(r"residua-plant/(\d{1,9})", str(found))
        advice = "; upgrade residua" if named and int(named[1]) > _VERSION else ""
        raise root.error("format", f"expected {FORMAT!r}, got {kind_of(found)}{advice}")
    try:
        plant = _core(root)
        for entry in root.tables("disturbances", ("name", "state", "output")):
            plant = _pointing(entry, partial(plant.with_disturbances, {entry.text("name"): _vectors(plant, entry)}))
        for entry in root.tables("faults", FAULT_KEYS):
            plant = _with_fault(plant, entry)
        plant = _sampled(plant, root)
        return _with_noise(plant, root.table("noise", ("process", "measurement", "cross", "state", "output")))
    except (ModelError, AccuracyError, np.linalg.LinAlgError, ArithmeticError, MemoryError) as error:
        raise FileFormatError(f"{source}: {error}") from error


def _core(root: Entry) -> Plant:
    """Return the plant without disturbances, faults and noise."""
    matrices = root.table("matrices", ("A", "B", "C", "D", "E"))
    A = _required(matrices, "A", None, None, "")
    n = len(A)
    if A.shape[1] != n:
        raise matrices.error("A", f"must be square, got {n} x {A.shape[1]}")
    C = _required(matrices, "C", None, n, "one per state")
    p = len(C)
    D = matrices.matrix("D", p, None, "one per output")
    B = matrices.matrix("B", n, None, "one per state")
    if B is None:
        B = np.zeros((n, 0))
    if n == 0 and D is not None:  # a matrix without rows does not tell its columns
        B = np.zeros((0, D.shape[1]))
    m = B.shape[1]
    if D is not None and D.shape[1] != m:
        raise matrices.error("D", f"expected {m} columns (one per column of B), got {D.shape[1]}")
    channels: dict[str, tuple[str, ...] | None] = {}
    units: dict[str, str] = {}
    points: dict[str, tuple[float, ...]] = {}
    for group, count, letter in (("states", n, "x"), ("inputs", m, "u"), ("outputs", p, "y")):
        keys = CHANNEL_KEYS[:2] if group == "states" else CHANNEL_KEYS
        table = root.table(group, keys)
        each = f"one per {group[:-1]}"
        names = table.texts("names", count, each)
        channels[group] = names
        labels = names or tuple(f"{letter}{i + 1}" for i in range(count))
        if isinstance(table.data.get("units"), dict):
            entry = table.table("units", labels)
            units |= {name: entry.text(name) for name in entry.data}
        else:
            listed_units = table.texts("units", len(labels), each) or ()
            units |= {name: unit for name, unit in zip(labels, listed_units, strict=False) if unit}
        values = table.by_channel("operating_point", labels, each) if group != "states" else None
        points[group] = tuple(np.zeros(count) if values is None else values)
    dt = root.number("dt", 0.0)
    if dt < 0:
        raise root.error("dt", f"must be 0 (continuous) or a positive step in seconds, got {dt}")
    return Plant(
        A,
        B,
        C,
        D,
        E=matrices.matrix("E", n, n, "one per state"),
        dt=dt,
        name=root.text("name", "plant"),
        description=root.text("description", ""),
        operating_point=OperatingPoint(points["inputs"], points["outputs"]),
        units=units,
        identification=_identification(root),
        **channels,
    )


def _identification(root: Entry) -> Identification | None:
    """Return the record of an identification, or ``None`` without one."""
    if "identification" not in root:
        return None
    entry = root.table("identification", IDENTIFICATION_KEYS)
    rows = entry.number("rows")
    if rows != int(rows) or rows < 1:
        raise entry.error("rows", f"must be a whole number of at least one, got {rows:g}")
    return Identification(
        entry.text("method"),
        int(rows),
        entry.texts("coloured", None, "") or (),
        entry.texts("weak_inputs", None, "") or (),
        tuple(entry.pairs("uncertain_gains")),
    )


def _with_fault(plant: Plant, entry: Entry) -> Plant:
    kind = entry.choice("kind", KINDS, "component")
    if kind == "actuator" and "input" in entry:
        channel = _channel(entry, "input", plant.inputs, ("state", "output"))
        state, output = plant.B[:, channel], plant.D[:, channel]
        label = plant.inputs[channel]
    elif kind == "sensor" and isinstance(entry.data.get("output"), str):
        channel = _channel(entry, "output", plant.outputs, ("state", "input"))
        state, output = np.zeros(plant.n_states), np.eye(plant.n_outputs)[channel]
        label = plant.outputs[channel]
    else:
        if "input" in entry:
            raise entry.error("input", f"only for kind = 'actuator'; this fault is of kind {kind!r}")
        state, output = _vectors(plant, entry)
        label = ""
    default = f"{label} {kind}" if label else None
    name = entry.text("name", default)
    component = entry.text("component", label or name)
    if not component.strip():
        raise entry.error("component", "must not be empty")
    notes = {key: entry.text(key) for key in FAULT_NOTES if key in entry}

    def noted() -> Plant:
        return plant.with_faults({name: (state, output)}, kind=kind, component=component).with_fault_notes(
            {name: notes}
        )

    return _pointing(entry, noted)


def _vectors(plant: Plant, entry: Entry) -> tuple[NDArray, NDArray]:
    """Return the state and output direction of a fault or disturbance."""
    state = entry.by_channel("state", plant.states, "one per state")
    output = entry.by_channel("output", plant.outputs, "one per output")
    if state is None and output is None:
        raise entry.error("state", "say how it enters: state = [...], output = [...], or both")
    state = np.zeros(plant.n_states) if state is None else state
    output = np.zeros(plant.n_outputs) if output is None else output
    if not (state.any() or output.any()):
        raise entry.error("state", "it has no effect: every number is zero")
    return state, output


def _sampled(plant: Plant, root: Entry) -> Plant:
    if "sample_time" not in root:
        return plant
    step = root.number("sample_time")
    if step <= 0:
        raise root.error("sample_time", f"must be a positive step in seconds, got {step}")
    if plant.dt:
        raise root.error("sample_time", f"the matrices are sampled already (dt = {plant.dt})")
    try:
        return plant.discretize(step)
    except (ModelError, AccuracyError, np.linalg.LinAlgError, ArithmeticError) as error:
        raise root.error("sample_time", str(error)) from error


def _with_noise(plant: Plant, entry: Entry) -> Plant:
    """Add noise given by covariances, or by the directions of unit white noise into states and outputs."""
    if not entry.data:
        return plant
    if "state" in entry or "output" in entry:
        for key in ("process", "measurement", "cross"):
            if key in entry:
                raise entry.error(key, "give covariances (process, measurement, cross) or directions (state, output)")
        Bw = entry.matrix("state", plant.n_states, None, "one per state")
        Dw = entry.matrix("output", plant.n_outputs, None, "one per output")
        if Dw is None:
            Dw = np.zeros((plant.n_outputs, 0 if Bw is None else Bw.shape[1]))
        if Bw is None or plant.n_states == 0:
            Bw = np.zeros((plant.n_states, Dw.shape[1]))
        if Bw.shape[1] != Dw.shape[1]:
            raise entry.error("output", f"expected {Bw.shape[1]} columns (as in state), got {Dw.shape[1]}")
        return plant.with_noise_input(Bw, Dw)
    W = _covariance(entry, "process", plant.states, "one per state")
    V = _covariance(entry, "measurement", plant.outputs, "one per output")
    S = entry.matrix("cross", plant.n_states, plant.n_outputs, "one row per state, one column per output")
    return _pointing(entry, lambda: plant.with_noise(process=W, measurement=V, cross=S))


def _covariance(entry: Entry, key: str, channels: tuple[str, ...], each: str) -> NDArray | float | None:
    value = entry.data.get(key)
    if value is None:
        return None
    if isinstance(value, list) and value and all(isinstance(row, list) for row in value):
        return entry.matrix(key, len(channels), len(channels), each)
    if not isinstance(value, (list, dict)):
        return entry.number(key)
    return entry.by_channel(key, channels, each)


def _channel(entry: Entry, key: str, known: tuple[str, ...], excluded: tuple[str, ...]) -> int:
    """Return the channel of a fault, which says how it enters: other entries on that are excluded."""
    name = entry.text(key)
    if name not in known:
        raise entry.error(key, f"unknown {key}{suggestion(name, known)}; known: {listed(known)}")
    for other in excluded:
        if other in entry:
            raise entry.error(other, f"not together with {key} = {echo(entry.data[key])}, which says how it enters")
    return known.index(name)


def _pointing(entry: Entry, make: Callable[[], Plant]) -> Plant:
    """Run ``make``, and let a model error point at the entry."""
    try:
        return make()
    except (ModelError, np.linalg.LinAlgError) as error:
        raise FileFormatError(f"{entry.source}: {entry.where()}: {error}") from error


def _required(entry: Entry, key: str, rows: int | None, columns: int | None, each: str) -> NDArray:
    M = entry.matrix(key, rows, columns, each)
    if M is None:
        raise entry.error(key, "this matrix is required")
    return M
