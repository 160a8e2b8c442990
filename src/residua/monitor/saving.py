"""Designs and monitors as JSON: every float to its last bit, a schema version, nothing executed."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.directional import Directional
from residua.decide.norm_threshold import NormTest, NormThreshold
from residua.design import Evidence, Member, Observer, ResidualGenerator
from residua.errors import FileFormatError, ResiduaError
from residua.linear import RankDecision, StateSpace
from residua.monitor.monitor import Monitor
from residua.monitor.running import State
from residua.plant import Fault, OperatingPoint, Plant

FORMAT = "residua-monitor"
VERSION = 1


def save_monitor(monitor: Monitor, path: str | Path) -> None:
    """Write a monitor with its thresholds and running state; the file appears whole or not at all."""
    content: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "design": _generator_out(monitor.design),
        "dt": None if monitor._generator is None else monitor._generator.dt,
        "test": {name: getattr(monitor.test, name) for name in _fields(NormThreshold)},
        "isolate": None
        if monitor.isolate is None
        else {name: getattr(monitor.isolate, name) for name in _fields(Directional)},
        "settle": monitor.settle,
        "max_hold": monitor.max_hold,
        "notes": list(monitor.notes),
        "fitted": None if monitor._norm_test is None else _plain_out(monitor._norm_test, NormTest),
        "state": None if monitor._state is None else _plain_out(monitor._state, State),
    }
    write_text(Path(path), json.dumps(content, allow_nan=False) + "\n")


def load_monitor(path: str | Path) -> Monitor:
    """Read a monitor; raises :class:`FileFormatError` that says which entry is wrong."""
    path = Path(path)
    content = _read(path)
    try:
        isolate = content["isolate"]
        monitor = Monitor(
            _generator_in(content["design"]),
            test=NormThreshold(**content["test"]),
            isolate=None if isolate is None else Directional(**isolate),
            dt=content["dt"],
            settle=content["settle"],
            max_hold=content["max_hold"],
        )
        monitor.notes = tuple(content["notes"])
        if content["fitted"] is not None:
            monitor._norm_test = NormTest(**_plain_in(content["fitted"]))
            _check_shapes(monitor)
        if content["state"] is not None:
            monitor._state = State(**_plain_in(content["state"]))
            _check_state(monitor)
    except KeyError as error:
        raise FileFormatError(f"{path.name}: the entry {error.args[0]!r} is missing") from error
    except FileFormatError as error:
        raise FileFormatError(f"{path.name}: {error}") from error
    except (TypeError, ValueError, AttributeError, IndexError, ResiduaError) as error:
        raise FileFormatError(f"{path.name}: {error}") from error
    return monitor


def _read(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileFormatError(f"cannot read {path}: {error.strerror or error}") from error
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise FileFormatError(f"{path.name} is not JSON: {error}") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise FileFormatError(f'{path.name} is not a monitor of residua (no "format": {FORMAT!r} in it)')
    if content.get("version") != VERSION:
        raise FileFormatError(
            f"{path.name} has schema version {content.get('version')!r}, this residua reads version {VERSION}: "
            "make the monitor anew with this version"
        )
    return content


def write_text(path: Path, text: str) -> None:
    """Write a file so that it appears whole or not at all."""
    folder = path.parent
    if not folder.is_dir():
        raise FileFormatError(f"the folder {folder} does not exist")
    handle, name = tempfile.mkstemp(dir=folder, prefix=path.name, suffix=".part")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.chmod(name, 0o666 & ~_umask())
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


# -------------------------------------------------------------------- encoding


def _fields(cls: type) -> tuple[str, ...]:
    return tuple(cls.__dataclass_fields__)  # pyright: ignore[reportAttributeAccessIssue]


def _array_out(value: NDArray) -> dict[str, Any]:
    kind = value.dtype.kind
    if kind == "c":
        return {
            "shape": list(value.shape),
            "complex": [[_float_out(z.real), _float_out(z.imag)] for z in value.ravel()],
        }
    if kind == "f":
        return {"shape": list(value.shape), "float": [_float_out(x) for x in value.ravel()]}
    return {"shape": list(value.shape), {"b": "bool"}.get(kind, "int"): value.ravel().tolist()}


def _float_out(x: float) -> float | str:
    return float(x) if np.isfinite(x) else repr(float(x))


def _array_in(value: Any) -> NDArray:
    if not isinstance(value, Mapping) or "shape" not in value:
        raise FileFormatError("an array must be {shape, float | complex | int | bool}")
    shape = tuple(int(n) for n in value["shape"])
    if "complex" in value:
        flat = np.array([complex(float(a), float(b)) for a, b in value["complex"]], dtype=complex)
    elif "float" in value:
        flat = np.array([float(x) for x in value["float"]], dtype=float)
    elif "int" in value:
        flat = np.array(value["int"], dtype=np.int64)
    else:
        flat = np.array(value["bool"], dtype=bool)
    if flat.size != int(np.prod(shape)):
        raise FileFormatError(f"an array of shape {shape} has {flat.size} numbers")
    return flat.reshape(shape)


def _plain_out(record: Any, cls: type) -> dict[str, Any]:
    out = {}
    for name in _fields(cls):
        value = getattr(record, name)
        if isinstance(value, np.ndarray):
            value = _array_out(value)
        elif isinstance(value, float):
            value = {"shape": [], "float": [_float_out(value)]}
        out[name] = value
    return out


def _plain_in(content: Mapping[str, Any]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name, value in content.items():
        if isinstance(value, Mapping):
            array = _array_in(value)
            out[name] = float(array) if array.ndim == 0 else array
        else:
            out[name] = value
    return out


# ---------------------------------------------------------- plants and designs


def _system_out(system: StateSpace) -> dict[str, Any]:
    out: dict[str, Any] = {name: _array_out(getattr(system, name)) for name in "ABCD"}
    out |= {"dt": system.dt, "inputs": system.inputs, "outputs": system.outputs, "states": system.states}
    return out


def _system_in(content: Mapping[str, Any]) -> StateSpace:
    matrices = [_array_in(content[name]) for name in "ABCD"]
    return StateSpace(
        *matrices,
        dt=content["dt"],
        inputs=content["inputs"],
        outputs=content["outputs"],
        states=content["states"],
    )


_PLANT_ARRAYS = ("A", "C", "Bu", "Du", "Bd", "Dd", "Bf", "Df", "Bw", "Dw")


def _plant_out(plant: Plant) -> dict[str, Any]:
    out: dict[str, Any] = {name: _array_out(getattr(plant, name)) for name in _PLANT_ARRAYS}
    out |= {name: getattr(plant, name) for name in ("dt", "inputs", "outputs", "states", "disturbances", "name")}
    out["faults"] = [[fault.name, fault.kind, fault.component] for fault in plant.fault_list]
    out["operating_point"] = [plant.operating_point.inputs, plant.operating_point.outputs]
    out["units"] = dict(plant.units)
    return out


def _plant_in(content: Mapping[str, Any]) -> Plant:
    a = {name: _array_in(content[name]) for name in _PLANT_ARRAYS}
    u0, y0 = content["operating_point"]
    plant = Plant(
        a["A"],
        a["Bu"],
        a["C"],
        a["Du"],
        dt=content["dt"],
        inputs=content["inputs"],
        outputs=content["outputs"],
        states=content["states"],
        name=content["name"],
        operating_point=OperatingPoint(tuple(u0), tuple(y0)),
        units=content["units"],
    )
    for letter in "dfw":
        if a["B" + letter].shape[0] != len(a["A"]) or a["D" + letter].shape[0] != len(a["C"]):
            raise FileFormatError(f"plant: B{letter} or D{letter} does not fit the plant")
    faults = tuple(Fault(*entry) for entry in content["faults"])
    if len(faults) != a["Bf"].shape[1] or len(content["disturbances"]) != a["Bd"].shape[1]:
        raise FileFormatError("plant: names and columns of faults or disturbances do not match")
    return plant._with(
        **{name: a[name] for name in _PLANT_ARRAYS[4:]},
        disturbances=tuple(content["disturbances"]),
        fault_list=faults,
    )


def _evidence_out(evidence: Evidence) -> dict[str, Any]:
    return {
        "method": evidence.method,
        "poles": _array_out(evidence.poles),
        "requested_poles": _array_out(evidence.requested_poles),
        "fixed_poles": _array_out(evidence.fixed_poles),
        "decoupling": {k: _float_out(v) for k, v in evidence.decoupling.items()},
        "conditions": {k: _float_out(v) for k, v in evidence.conditions.items()},
        "ranks": {
            name: [d.rank, _array_out(np.asarray(d.singular_values)), d.tolerance] for name, d in evidence.ranks.items()
        },
        "notes": evidence.notes,
        "references": evidence.references,
    }


def _evidence_in(content: Mapping[str, Any]) -> Evidence:
    return Evidence(
        method=content["method"],
        poles=_array_in(content["poles"]),
        requested_poles=_array_in(content["requested_poles"]),
        fixed_poles=_array_in(content["fixed_poles"]),
        decoupling={k: float(v) for k, v in content["decoupling"].items()},
        conditions={k: float(v) for k, v in content["conditions"].items()},
        ranks={k: RankDecision(int(r), _array_in(s), float(t)) for k, (r, s, t) in content["ranks"].items()},
        notes=tuple(content["notes"]),
        references=tuple(content["references"]),
    )


_OBSERVER_ARRAYS = ("F", "T", "H", "K1", "W")


def _generator_out(generator: ResidualGenerator) -> dict[str, Any]:
    observer = generator.observer
    return {
        "system": _system_out(generator.system),
        "plant": _plant_out(generator.plant),
        "method": generator.method,
        "evidence": _evidence_out(generator.evidence),
        "subspaces": {name: _array_out(basis) for name, basis in generator.subspaces.items()},
        "members": [[m.name, m.residuals, m.faults] for m in generator.members],
        "observer": None
        if observer is None
        else {
            **{name: _array_out(getattr(observer, name)) for name in _OBSERVER_ARRAYS},
            "plant": _plant_out(observer.plant),
            "method": observer.method,
            "decouples": observer.decouples,
            "evidence": _evidence_out(observer.evidence),
        },
    }


def _generator_in(content: Mapping[str, Any]) -> ResidualGenerator:
    observer = None
    if content["observer"] is not None:
        o = content["observer"]
        arrays = {name: _array_in(o[name]) for name in _OBSERVER_ARRAYS}
        observer = Observer(
            plant=_plant_in(o["plant"]),
            method=o["method"],
            decouples=bool(o["decouples"]),
            evidence=_evidence_in(o["evidence"]),
            **arrays,
        )
    return ResidualGenerator(
        system=_system_in(content["system"]),
        plant=_plant_in(content["plant"]),
        method=content["method"],
        evidence=_evidence_in(content["evidence"]),
        subspaces={name: _array_in(basis) for name, basis in content["subspaces"].items()},
        observer=observer,
        members=tuple(Member(name, tuple(rows), tuple(faults)) for name, rows, faults in content["members"]),
    )


def _check_shapes(monitor: Monitor) -> None:
    k = monitor.generator.n_residuals
    test = monitor.norm_test
    if test.center.shape != (k,) or test.whitening.shape != (k, k):
        raise FileFormatError(f"fitted: center and whitening must be for {k} residuals")


def _check_state(monitor: Monitor) -> None:
    state, spec = monitor._state, monitor._specification()
    assert state is not None
    n, m, k, window = len(spec.A), spec.B.shape[1], len(spec.C), spec.window
    plants = len(state.x)
    wanted = {
        "x": (plants, n),
        "held": (plants, m),
        "previous": (plants, window, k),
        "current": (plants, window, k),
        "test_previous": (plants, spec.test.window, k),
        "test_current": (plants, spec.test.window, k),
    }
    for name in _fields(State):
        value = getattr(state, name)
        shape = wanted.get(name, (plants,))
        if isinstance(value, np.ndarray) and value.shape != shape:
            raise FileFormatError(f"state.{name} must have shape {shape}, got {value.shape}")


__all__ = ["FORMAT", "VERSION", "load_monitor", "save_monitor", "write_text"]
