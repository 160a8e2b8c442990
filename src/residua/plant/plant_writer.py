"""Writing plant files, which read back as the same plant to the last bit."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError, ModelError
from residua.files import write_text
from residua.plant.channels import FAULT_NOTES
from residua.plant.noise import noise_factors
from residua.plant.plant import Plant
from residua.plant.plant_file import FORMAT, loads_plant


def save_plant(plant: Plant, path: str | Path) -> Path:
    """Write a plant file; see :func:`dumps_plant`.

    Parameters
    ----------
    plant : Plant
    path : str or Path

    Returns
    -------
    Path
        Where it was written; the file appears whole or not at all.
    """
    return write_text(path, dumps_plant(plant))


def dumps_plant(plant: Plant) -> str:
    """Return the text of a plant file that describes this plant.

    Guaranteed, and checked here: :func:`load_plant` makes the same plant from it, every float to the last
    bit.

    Parameters
    ----------
    plant : Plant

    Returns
    -------
    str

    Raises
    ------
    AccuracyError
        If the text does not give the same plant back (a fault of this function).

    Examples
    --------
    >>> import residua as rs
    >>> from residua.plant import dumps_plant
    >>> print(dumps_plant(rs.Plant([[-1.0]], [[1.0]], [[2.0]], name="lag").with_sensor_faults()))
    format = "residua-plant/1"
    name = "lag"
    dt = 0.0
    <BLANKLINE>
    [states]
    names = ["x1"]
    <BLANKLINE>
    [inputs]
    names = ["u1"]
    operating_point = [0.0]
    <BLANKLINE>
    [outputs]
    names = ["y1"]
    operating_point = [0.0]
    <BLANKLINE>
    [matrices]
    A = [[-1.0]]
    B = [[1.0]]
    C = [[2.0]]
    <BLANKLINE>
    [[faults]]
    name = "y1 sensor"
    kind = "sensor"
    component = "y1"
    output = "y1"
    <BLANKLINE>
    """
    head = [f"format = {_text(FORMAT)}", f"name = {_text(plant.name)}"]
    if plant.description:
        head.append(f"description = {_text(plant.description)}")
    head.append(f"dt = {_number(plant.dt)}")
    matrices = ["[matrices]", f"A = {_matrix(plant.A)}"]
    if plant.inputs:
        matrices.append(f"B = {_matrix(plant.B)}")
    matrices.append(f"C = {_matrix(plant.C)}")
    if plant.inputs and (_matters(plant.D) or plant.n_states == 0):
        matrices.append(f"D = {_matrix(plant.D)}")
    if plant.E is not None:
        matrices.append(f"E = {_matrix(plant.E)}")
    blocks = [head, *_channels(plant)]
    record = plant.identification
    if record is not None:
        lines = ["[identification]", f"method = {_text(record.method)}", f"rows = {record.rows}"]
        for key, channels in (("coloured", record.coloured), ("weak_inputs", record.weak_inputs)):
            lines += [f"{key} = {_texts(channels)}"] if channels else []
        if record.uncertain_gains:
            lines.append(f"uncertain_gains = [{', '.join(map(_texts, record.uncertain_gains))}]")
        blocks.append(lines)
    blocks.append(matrices)
    for name, b, d in zip(plant.disturbances, plant.Bd.T, plant.Dd.T, strict=True):
        blocks.append(["[[disturbances]]", f"name = {_text(name)}", *_vectors(plant, b, d)])
    blocks += [_fault(plant, i) for i in range(len(plant.faults))]
    if plant.Bw.shape[1]:
        blocks.append(["[noise]", *_noise(plant)])
    text = "\n\n".join("\n".join(lines) for lines in blocks) + "\n"
    different = differences(plant, loads_plant(text, source=plant.name))
    if different:
        raise AccuracyError(f"the plant file does not give the same plant back: {', '.join(different)} differ")
    return text


def differences(one: Plant, other: Plant) -> list[str]:
    """Return the names of the attributes in which two plants differ, to the last bit."""
    return [key for key in Plant.__dataclass_fields__ if not _same(getattr(one, key), getattr(other, key))]


def _same(one: object, other: object) -> bool:
    """Tell whether two values are equal, arrays to the last bit."""
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return one.shape == other.shape and one.tobytes() == other.tobytes()
    return not isinstance(one, np.ndarray) and not isinstance(other, np.ndarray) and one == other


def _channels(plant: Plant) -> list[list[str]]:
    blocks = []
    point = plant.operating_point
    for group, names, values in (
        ("states", plant.states, None),
        ("inputs", plant.inputs, point.inputs),
        ("outputs", plant.outputs, point.outputs),
    ):
        if not names:
            continue
        lines = [f"[{group}]", f"names = {_texts(names)}"]
        units = {name: plant.units[name] for name in names if name in plant.units}
        if units and all(units.get(name) for name in names):
            lines.append(f"units = {_texts(units[name] for name in names)}")
        elif units:
            lines.append("units = " + _inline((name, _text(unit)) for name, unit in units.items()))
        if values is not None:
            lines.append(f"operating_point = {_row(values)}")
        blocks.append(lines)
    return blocks


def _fault(plant: Plant, i: int) -> list[str]:
    fault, b, d = plant.fault_list[i], plant.Bf[:, i], plant.Df[:, i]
    lines = [
        "[[faults]]",
        f"name = {_text(fault.name)}",
        f"kind = {_text(fault.kind)}",
        f"component = {_text(fault.component)}",
        *(f"{key} = {_text(getattr(fault, key))}" for key in FAULT_NOTES if getattr(fault, key)),
    ]
    if fault.kind == "actuator":
        for j, name in enumerate(plant.inputs):
            if _same(b, plant.B[:, j]) and _same(d, plant.D[:, j]):
                return [*lines, f"input = {_text(name)}"]
    if fault.kind == "sensor" and not _matters(b):
        for j, name in enumerate(plant.outputs):
            if _same(d, np.eye(plant.n_outputs)[j]):
                return [*lines, f"output = {_text(name)}"]
    return lines + _vectors(plant, b, d)


def _vectors(plant: Plant, state: NDArray, output: NDArray) -> list[str]:
    """Return the direction of a fault or disturbance: by name if few numbers are not zero."""
    lines = []
    for key, vector, names in (("state", state, plant.states), ("output", output, plant.outputs)):
        if not _matters(vector):
            continue
        entries = [(name, _number(x)) for name, x in zip(names, vector, strict=True) if _matters(x)]
        lines.append(f"{key} = " + (_inline(entries) if 2 * len(entries) <= len(names) else _row(vector)))
    return lines


def _noise(plant: Plant) -> list[str]:
    """Return variances if they restore the noise, otherwise the directions themselves."""
    try:
        W, V = (_variances(M @ M.T) for M in (plant.Bw, plant.Dw))
        Bw, Dw = noise_factors(np.diag(W), np.diag(V))
        if _same(Bw, plant.Bw) and _same(Dw, plant.Dw):
            return [f"{key} = {_row(values)}" for key, values in (("process", W), ("measurement", V)) if values.any()]
    except ModelError:
        pass
    lines = [f"state = {_matrix(plant.Bw)}"] if plant.n_states else []
    return [*lines, f"output = {_matrix(plant.Dw)}"]


def _variances(W: NDArray) -> NDArray:
    """Return the shortest decimal variances with the same square roots as the diagonal."""
    out = np.diag(W).copy()
    for i, variance in enumerate(out):
        for digits in range(1, 18):
            short = float(f"{variance:.{digits}g}")
            if np.sqrt(short) == np.sqrt(variance):
                out[i] = short
                break
    return out


def _matters(values: NDArray | float) -> bool:
    """Tell whether any value is not +0.0 (a negative zero is written, so that it is restored)."""
    return bool(np.any(values) or np.signbit(values).any())


def _number(x: float) -> str:
    return repr(float(x))


def _row(values: Iterable[float]) -> str:
    return "[" + ", ".join(_number(x) for x in values) + "]"


def _matrix(M: NDArray) -> str:
    rows = [_row(row) for row in M]
    flat = "[" + ", ".join(rows) + "]"
    return flat if len(flat) <= 60 else "[\n" + "".join(f"  {row},\n" for row in rows) + "]"


def _texts(values: Iterable[str]) -> str:
    return "[" + ", ".join(_text(value) for value in values) + "]"


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _inline(entries: Iterable[tuple[str, str]]) -> str:
    pairs: Sequence[str] = [
        f"{name if re.fullmatch(r'[A-Za-z0-9_-]+', name) else _text(name)} = {value}" for name, value in entries
    ]
    return "{" + ", ".join(pairs) + "}"
