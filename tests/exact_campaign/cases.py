"""A generated plant in small fractions, the units it is written in, and the plant of floats that comes of both."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

import residua as rs
from exact.responses import Scales

Rows = list[list[Fraction]]


@dataclass(frozen=True)
class Case:
    """The matrices of a plant in base units; faults of sensors and actuators are named by their channel."""

    kind: str
    seed: int
    A: Rows
    B: Rows
    C: Rows
    D: Rows
    Bd: Rows
    Dd: Rows
    Bf: Rows
    Df: Rows
    E: Rows | None = None
    dt: float = 0.0
    sensors: tuple[int, ...] = ()
    actuators: tuple[int, ...] = ()

    @property
    def sizes(self) -> tuple[int, int, int, int, int]:
        """Numbers of states, inputs, outputs, disturbances and faults with directions of their own."""
        return len(self.A), len(self.D[0]), len(self.C), len(self.Dd[0]), len(self.Df[0])


@dataclass(frozen=True)
class Units:
    """Factors for states, inputs, outputs, disturbances, faults and, where ``E`` is singular, equations.

    ``t`` is that of the rates of a continuous plant; a sampled one has none.
    """

    x: NDArray[np.float64]
    u: NDArray[np.float64]
    y: NDArray[np.float64]
    d: NDArray[np.float64]
    f: NDArray[np.float64]
    r: NDArray[np.float64]
    name: str = field(default="base")
    t: float = 1.0


def base_units(case: Case) -> Units:
    """Return factors of one."""
    n, m, p, q, k = case.sizes
    return Units(np.ones(n), np.ones(m), np.ones(p), np.ones(q), np.ones(k), np.ones(n))


def units(case: Case, seed: int, *, powers_of_two: bool, span: float | None = None) -> Units:
    """Return random factors: powers of two from 2^-20 to 2^20, or of ten from 10^-6 to 10^6."""
    rng = np.random.default_rng([91, seed, int(powers_of_two)])
    n, m, p, q, k = case.sizes

    def factors(count: int) -> NDArray[np.float64]:
        if powers_of_two:
            most = 20 if span is None else span
            return 2.0 ** np.round(rng.uniform(-most, most, count))
        return 10.0 ** np.round(rng.uniform(-6, 6, count))

    x, u, y, d, f = (factors(count) for count in (n, m, p, q, k))
    r = factors(n) if case.E is not None else 1 / x
    return Units(x, u, y, d, f, r, "powers of two" if powers_of_two else "powers of ten")


def in_other_time(case: Case, by: Units, seed: int) -> Units:
    """Return units with one of time, from 2^-20 to 2^20: of continuous plants, if they have a rate.

    Without one what an answer of the size of a fault is made of depends on it: faults have units of their own.
    """
    if case.dt or not plant_of(case).system(()).poles().any():
        return by
    k = int(np.random.default_rng([92, seed]).integers(-20, 21))
    return replace(by, t=2.0**k)


def floats(rows: Rows, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return a matrix of fractions as floats."""
    return np.array([[float(x) for x in row] for row in rows], dtype=float).reshape(shape)


def plant_of(case: Case, by: Units | None = None, *, noise: bool = False) -> rs.Plant:
    """Return the plant in units: a state of the case is ``x`` times the state of the plant, and so on."""
    by = base_units(case) if by is None else by
    _, _, _, q, k = case.sizes
    left = by.r if case.E is not None else 1 / by.x
    rates = left * by.t

    def scaled(rows: Rows, first: NDArray, second: NDArray) -> NDArray[np.float64]:
        return first[:, None] * floats(rows, (len(first), len(second))) * second

    plant = rs.Plant(
        scaled(case.A, rates, by.x),
        scaled(case.B, rates, by.u),
        scaled(case.C, 1 / by.y, by.x),
        scaled(case.D, 1 / by.y, by.u),
        E=None if case.E is None else scaled(case.E, left, by.x),
        dt=case.dt,
        name=f"{case.kind} {case.seed}",
    )
    if q:
        Bd, Dd = scaled(case.Bd, rates, by.d), scaled(case.Dd, 1 / by.y, by.d)
        plant = plant.with_disturbances({f"d{i + 1}": (Bd[:, i], Dd[:, i]) for i in range(q)})
    if k:
        Bf, Df = scaled(case.Bf, rates, by.f), scaled(case.Df, 1 / by.y, by.f)
        plant = plant.with_faults({f"f{i + 1}": (Bf[:, i], Df[:, i]) for i in range(k)})
    plant = plant.with_actuator_faults(case.actuators).with_sensor_faults(case.sensors)
    if noise:
        plant = plant.with_noise(process=np.diag(rates**2), measurement=np.diag(1 / by.y**2))
    return plant


def units_of_faults(plant: rs.Plant, by: Units) -> NDArray[np.float64]:
    """Return the factors of the faults of a plant: those of sensors and actuators have that of their channel."""
    units = np.ones(len(plant.faults))
    for i, fault in enumerate(plant.fault_list):
        if fault.kind == "sensor":
            units[i] = by.y[plant.outputs.index(fault.component)]
        else:
            units[i] = by.u[plant.inputs.index(fault.component)] if fault.kind == "actuator" else by.f[i]
    return units


def scales_of(plant: rs.Plant, by: Units) -> Scales | None:
    """Return the powers of two that take a plant in some units to base units; ``None`` where these are no such."""
    if by.name == "powers of ten":
        return None
    equations = 1 / by.x if plant.E is None else by.r
    inputs = np.concatenate([by.u, by.d, units_of_faults(plant, by)])
    return Scales(by.x, equations, by.y, inputs, by.t)


def literal(plant: rs.Plant) -> str:
    """Return Python text that makes the same plant again, to the last bit."""

    def text(M: NDArray) -> str:
        if not M.size:
            return f"np.zeros({M.shape})"
        return "[" + ", ".join("[" + ", ".join(_number(x) for x in row) + "]" for row in M) + "]"

    out = f"rs.Plant({text(plant.A)}, {text(plant.B)}, {text(plant.C)}"
    out += f", {text(plant.D)}" if np.any(plant.D) else ""
    out += f", E={text(plant.E)}" if plant.E is not None else ""
    out += f", dt={plant.dt}" if plant.dt else ""
    out += ")"
    if plant.disturbances:
        out += f".with_disturbances({{{_columns(plant.disturbances, plant.Bd, plant.Dd)}}})"
    own = [i for i, kind in enumerate(plant.fault_kinds) if kind == "component"]
    if own:
        out += f".with_faults({{{_columns([plant.faults[i] for i in own], plant.Bf[:, own], plant.Df[:, own])}}})"
    actuators = [plant.inputs.index(f.component) for f in plant.fault_list if f.kind == "actuator"]
    sensors = [plant.outputs.index(f.component) for f in plant.fault_list if f.kind == "sensor"]
    out += f".with_actuator_faults({actuators})" if actuators else ""
    return out + (f".with_sensor_faults({sensors})" if sensors else "")


def _columns(names: list[str] | tuple[str, ...], B: NDArray, D: NDArray) -> str:
    def column(M: NDArray, i: int) -> str:
        return "[" + ", ".join(_number(x) for x in M[:, i]) + "]"

    return ", ".join(
        f'"{name}": ({column(B, i)}, {column(D, i)})' if np.any(D[:, i]) else f'"{name}": {column(B, i)}'
        for i, name in enumerate(names)
    )


def _number(x: float) -> str:
    x = float(x)
    if x == int(x) and abs(x) < 1e6:
        return str(int(x))
    mantissa, exponent = np.frexp(x)
    whole = int(mantissa * 2**53)
    power = int(exponent) - 53
    while whole % 2 == 0:
        whole, power = whole // 2, power + 1
    if abs(whole) < 1000:
        return f"{whole}*2.**{power}" if abs(whole) != 1 else f"{'-' if whole < 0 else ''}2.**{power}"
    return repr(x)


def smaller(case: Case) -> list[Case]:
    """Return cases with something left out: a fault, a disturbance, an input, an output."""
    _, m, _, q, k = case.sizes
    out = [replace(case, sensors=tuple(j for j in case.sensors if j != i)) for i in case.sensors]
    out += [replace(case, actuators=tuple(j for j in case.actuators if j != i)) for i in case.actuators]
    out += [replace(case, Bf=_less(case.Bf, i), Df=_less(case.Df, i)) for i in range(k)]
    out += [replace(case, Bd=_less(case.Bd, i), Dd=_less(case.Dd, i)) for i in range(q)]
    for i in range(m):
        if m > 1:
            kept = tuple(j - (j > i) for j in case.actuators if j != i)
            out.append(replace(case, B=_less(case.B, i), D=_less(case.D, i), actuators=kept))
    return out


def _less(rows: Rows, column: int) -> Rows:
    return [[x for j, x in enumerate(row) if j != column] for row in rows]
