"""Scenario of a campaign: the fault, its shape and its size; and scenarios from TOML files."""

from __future__ import annotations

import inspect
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from residua.errors import FileFormatError, SettingError
from residua.files import read_bytes
from residua.plant import Plant
from residua.tolerances import RESPONSE_ROUNDING
from residua.validate.shapes import SHAPES, LossOfEffectiveness, Shape, StuckAt
from residua.visible import echo, listed


@dataclass(frozen=True)
class Scenario:
    """A fault with its shape in time and its size, or several sizes, each of them a separate case.

    Parameters
    ----------
    fault : str
        A fault of the plant.
    shape : Shape
        :func:`step`, :func:`ramp`, :func:`drift`, :func:`intermittent`, :func:`oscillation`, :func:`noise_growth`,
        :func:`stuck_at` or :func:`loss_of_effectiveness`.
    size : float or sequence of float
        In the unit of the fault: the factor of its direction. Not zero. Of a loss of effectiveness the lost part; a
        stuck channel has none.

    Raises
    ------
    SettingError
        If a size is zero or not finite, or the shape is none.

    Examples
    --------
    >>> import residua as rs
    >>> print(rs.validate.Scenario("leak", shape=rs.validate.ramp(slope=0.01, at=600), size=0.05))
    leak, ramp(slope=0.01, at=600), size 0.05
    """

    fault: str
    shape: Shape
    size: float | Sequence[float] = 1.0

    def __post_init__(self) -> None:
        """Check shape and sizes."""
        if not isinstance(self.shape, Shape):
            raise SettingError(f"shape must be one of rs.validate's ({', '.join(SHAPES)}), got {echo(self.shape)}")
        try:
            sizes = tuple(np.asarray(self.size, dtype=float).ravel().tolist())
        except (TypeError, ValueError):
            sizes = ()
        if not sizes or not np.isfinite(sizes).all():
            raise SettingError(
                f"scenario {echo(self.fault)}: every size must be a finite number, got {echo(self.size)}"
            )
        if not all(sizes):
            raise SettingError(
                f"scenario {echo(self.fault)}: a size of 0 is no fault; fault-free runs are part of every campaign"
            )
        if isinstance(self.shape, LossOfEffectiveness) and not all(0 < size <= 1 for size in sizes):
            raise SettingError(
                f"scenario {echo(self.fault)}: the size of a loss of effectiveness is the part that is lost, over "
                f"0 and up to 1, got {echo(self.size)}"
            )
        if isinstance(self.shape, StuckAt) and sizes != (1.0,):
            raise SettingError(
                f"scenario {echo(self.fault)}: a stuck channel has no size; where it sticks is stuck_at(value=...)"
            )
        object.__setattr__(self, "size", sizes[0] if len(sizes) == 1 else sizes)

    @property
    def sizes(self) -> tuple[float, ...]:
        """All sizes."""
        return self.size if isinstance(self.size, tuple) else (self.size,)  # pyright: ignore[reportReturnType]

    def __str__(self) -> str:
        sized = "" if isinstance(self.shape, StuckAt) else f", size {', '.join(f'{one:.6g}' for one in self.sizes)}"
        return f"{self.fault}, {self.shape}{sized}"


@dataclass(frozen=True)
class Case:
    """One fault of one size in one shape, to be simulated for every run.

    Attributes
    ----------
    fault : str
    shape : Shape
    size : float
    scenario : int
        Number of the scenario that it is of.
    """

    fault: str
    shape: Shape
    size: float
    scenario: int

    def __str__(self) -> str:
        return str(Scenario(self.fault, self.shape, self.size))


def cases_of(scenarios: Scenario | Iterable[Scenario], plant: Plant, samples: int, dt: float) -> tuple[Case, ...]:
    """Return the cases of scenarios, one for each size, checked against the plant and the length of a run.

    Raises
    ------
    SettingError
        If a fault is unknown, an onset is after the end, or a shape does not go with the kind of fault.
    """
    if isinstance(scenarios, str) or not isinstance(scenarios, Scenario | Iterable):
        raise SettingError(f"scenarios must be rs.validate.Scenario objects, got {echo(scenarios)}")
    given = [scenarios] if isinstance(scenarios, Scenario) else list(scenarios)
    out = []
    for number, one in enumerate(given):
        if not isinstance(one, Scenario):
            raise SettingError(f"scenarios must be rs.validate.Scenario objects, got {echo(one)}")
        if one.fault not in plant.faults:
            raise SettingError(f"the plant has no fault {echo(one.fault)}; known: {listed(plant.faults)}")
        length = (samples - 1) * dt
        if one.shape.latest_sample(dt) >= samples:
            raise SettingError(
                f"scenario {echo(one.fault)}: the onset at {one.shape.latest:g} s is after the last sample of a run at "
                f"{length:g} s ({samples} samples of {dt:g} s); onsets are in seconds: an earlier one, or more samples"
            )
        kind = plant.fault_kinds[plant.faults.index(one.fault)]
        if one.shape.acts != "adds":
            channel_of(one.fault, plant, f"{one.shape.name}: {echo(one.fault)} is a {kind} fault")
        out += [Case(one.fault, one.shape, size, number) for size in one.sizes]
    return tuple(out)


def channel_of(fault: str, plant: Plant, what: str = "") -> tuple[str, int]:
    """Return ``"u"`` or ``"y"`` and the number of the channel whose signal a sensor or actuator fault adds to.

    Raises
    ------
    SettingError
        If the fault is not that of one measured or commanded signal.
    """
    j = plant.faults.index(fault)
    kind, component = plant.fault_kinds[j], plant.fault_components[j]
    d = plant.Df[:, j]
    if kind == "sensor" and np.count_nonzero(d) == 1 and d.max() == 1.0:
        return "y", int(d.argmax())
    if kind == "actuator" and component in plant.inputs:
        i = plant.inputs.index(component)
        effect, command = (np.concatenate(pair) for pair in ((plant.Bf[:, j], d), (plant.B[:, i], plant.D[:, i])))
        if (np.abs(effect - command) <= RESPONSE_ROUNDING * np.abs(command)).all():
            return "u", i
    raise SettingError(
        f"{what}; only the signal of one sensor or actuator can be stuck or weakened (plant.with_sensor_faults, "
        "with_actuator_faults): use step, ramp or drift with the size that the fault has"
    )


def load_scenarios(path: str | Path) -> tuple[Scenario, ...]:
    """Read scenarios from a TOML file.

    Parameters
    ----------
    path : str or Path
        With a table ``[[scenario]]`` for each: ``fault``, ``shape`` (a name), the parameters of that shape, and
        ``size``.

    Returns
    -------
    tuple of Scenario

    Raises
    ------
    FileFormatError
        If the file is not TOML, or an entry is missing, unknown or invalid; the message names it.

    Examples
    --------
    A file with one scenario in three sizes::

        [[scenario]]
        fault = "leak"
        shape = "ramp"
        slope = 0.01
        at = 600
        size = [0.02, 0.05, 0.1]
    """
    data = read_bytes(path, "scenario file")
    try:
        content = tomllib.loads(data.decode("utf-8"))
    except ValueError as error:
        raise FileFormatError(f"{path} is not TOML: {error}") from error
    tables = content.get("scenario")
    if not isinstance(tables, list) or not tables or set(content) != {"scenario"}:
        raise FileFormatError(f"{path}: expected tables [[scenario]] and nothing else, got {listed(content)}")
    return tuple(_scenario(table, f"{path}: scenario {number}") for number, table in enumerate(tables, 1))


def _scenario(table: Any, where: str) -> Scenario:
    """Return the scenario of a table."""
    if not isinstance(table, dict):
        raise FileFormatError(f"{where}: expected a table, got {echo(table)}")
    entries = dict(table)
    fault, shape, size = (entries.pop(name, None) for name in ("fault", "shape", "size"))
    if not isinstance(fault, str):
        raise FileFormatError(f"{where}: the entry 'fault' must be a name, got {echo(fault)}")
    if not isinstance(shape, str) or shape not in SHAPES:
        raise FileFormatError(f"{where}: the entry 'shape' must be one of {', '.join(SHAPES)}, got {echo(shape)}")
    takes = inspect.signature(SHAPES[shape]).parameters
    unknown = [name for name in entries if name not in takes]
    missing = [name for name, one in takes.items() if one.default is one.empty and name not in entries]
    if unknown or missing:
        what = f"the entry {echo(unknown[0])} is unknown" if unknown else f"the entry {echo(missing[0])} is missing"
        raise FileFormatError(f"{where}: {what}; a {shape} has fault, shape, size, {', '.join(takes)}")
    try:
        return Scenario(fault, SHAPES[shape](**entries), 1.0 if size is None else size)
    except (SettingError, TypeError, ValueError) as error:
        raise FileFormatError(f"{where}: {error}") from error
