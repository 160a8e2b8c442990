"""Monitors of every test and isolation that run in C, and recordings with missing values and changes."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from typing import Any

import numpy as np

import residua as rs
from residua.decide import CUSUM, EWMA, GLR, ChiSquared, Directional, MultiscaleEWMA, NormThreshold, Structured
from residua.decide.directional import DirectionTest
from residua.decide.isolation import NoNames
from residua.decide.member_thresholds import BankTest, GroupTest
from residua.decide.peak_threshold import PeakBankTest
from residua.decide.structured import code_test
from residua.monitor.fused import FusedRun, plan_of, run_block
from residua.monitor.plant_records import copied
from residua.monitor.running import Decisions, State, initial_state, joined_decisions, run_reference
from residua.monitor.specification import Specification
from residua.monitor.start_estimate import StartFit

MARKS = (np.nan, np.inf, -np.inf, 1e300, 1e308, 1e12, 1e200, 1e119, 1e140)

TESTS: dict[str, Any] = {
    "norm": NormThreshold(threshold=3.0),
    "norm over a window": NormThreshold(threshold=2.5, window=7, persistence=2, release=4),
    "page": CUSUM(threshold=4.0, form="page"),
    "crosier": CUSUM(threshold=5.0, form="crosier"),
    "pignatiello-runger": CUSUM(threshold=5.0, form="pignatiello-runger"),
    "ewma": EWMA(threshold=3.0, weight=0.2),
    "chi-squared": ChiSquared(threshold=3.5),
    "chi-squared over a window": ChiSquared(threshold=5.0, window=5),
    "glr": GLR(threshold=3.5, window=6),
    "glr along faults": GLR(threshold=3.5, window=5, directions="faults"),
    "means": MultiscaleEWMA(false_alarm_rate=0.01),
    "four means": MultiscaleEWMA(false_alarm_rate=0.01, weights=(1, 0.3, 0.1, 0.02)),
}
ISOLATIONS: dict[str, Any] = {
    "none": None,
    "short": Directional(window=3),
    "clear means": Directional(signature="steady"),
    "long": Directional(window=40, signature="steady"),
}
ORDERS = (0, 1, 2, 3, 4, 5, 8, 9)


def plant(order: int, outputs: int, inputs: int, seed: int) -> rs.Plant:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((order, order))
    A *= 0.8 / max(np.abs(np.linalg.eigvals(A)).max(initial=0.0), 1e-3)
    made = rs.Plant(A, rng.standard_normal((order, inputs)), rng.standard_normal((outputs, order)),
                    rng.standard_normal((outputs, inputs)), dt=1)  # fmt: skip
    return made.with_sensor_faults()


@cache
def specification(test: str, isolation: str, order: int, outputs: int, method: str) -> Specification:
    """Return what runs: a Kalman filter, or an observer, fitted where heavy tails and memory are to be taken off."""
    made = plant(order, outputs, 2, 7 * order + outputs)
    rng = np.random.default_rng(5)
    if method == "kalman" and order:
        made = made.with_noise(process=1e-2, measurement=1e-1)
        generator = rs.design.kalman_filter(made)
    elif order:
        generator = rs.design.unknown_input_observer(made).residual_generator()
    else:
        generator = rs.identify.given_residuals([f"r{j}" for j in range(outputs)])
    monitor = rs.Monitor(generator, test=TESTS[test], isolate=ISOLATIONS[isolation])
    channels = monitor.generator.system.n_inputs
    noise = rng.standard_t(4, (3000, channels))
    for k in range(1, len(noise)):
        noise[k] += 0.4 * noise[k - 1]
    n_u = len(monitor.generator.plant.inputs)
    if method != "kalman" or not order:
        monitor.fit(noise[:, :n_u] if n_u else None, noise[:, n_u:], held_out=0)
    return monitor._specification()


def recording(spec: Specification, rng: np.random.Generator, samples: int, marks: list[float]) -> np.ndarray:
    """Return data of three plants: one whole, one with marks, one with gaps, all with a change in the middle."""
    channels = spec.B.shape[1]
    data = rng.standard_normal((3, samples, channels)) + spec.offset
    data[:, samples // 2 : samples // 2 + 60] += 3 * rng.standard_normal(channels)
    for mark in marks:
        data[1, rng.integers(samples), rng.integers(channels)] = mark
    for _ in range(4):
        start, length = rng.integers(samples), rng.integers(1, 25)
        data[2, start : start + length, rng.integers(channels)] = np.nan
    return data


def same(one: Any, other: Any, where: str = "") -> None:
    """Assert that two dataclasses of arrays have the same bits; that of a NaN is not looked at."""
    if is_dataclass(one):
        for field in fields(one):
            same(getattr(one, field.name), getattr(other, field.name), f"{where}.{field.name}")
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype, where
        assert np.array_equal(one, other, equal_nan=one.dtype.kind == "f"), where
        if one.dtype.kind == "f":
            whole = ~np.isnan(one)
            assert np.array_equal(np.signbit(one[whole]), np.signbit(other[whole])), where
    else:
        assert one == other, where


def same_in_pieces(spec: Specification, data: np.ndarray, rng: np.random.Generator) -> tuple[State, Decisions]:
    """Assert that a recording that is cut somewhere has the bits of the reference, and return what this gives."""
    with np.errstate(all="ignore"):
        state, expected = run_reference(spec, initial_state(spec, len(data)), data)
        now, parts = initial_state(spec, len(data)), []
        for part in np.split(data, np.sort(rng.integers(0, data.shape[1] + 1, rng.integers(6))), axis=1):
            now, decisions = run_block(spec, now, part)
            parts.append(decisions)
    same(joined_decisions(parts), expected, "decisions")
    same(now, state, "state")
    return state, expected


def same_of_few_outputs(spec: Specification, data: np.ndarray, state: State, expected: Decisions, seed: int) -> None:
    """Assert that a run of which little is asked for has the same bits: loops leave out what nobody reads."""
    plan, rng = plan_of(spec), np.random.default_rng(seed)
    assert plan is not None
    run = FusedRun(spec, plan, copied(initial_state(spec, len(data))))
    names = [name for name in ("residuals", "statistic", "alarm", "fired", "scores") if rng.random() < 0.6]
    outputs = run.outputs(*data.shape[:2], names)
    cut = int(rng.integers(0, data.shape[1] + 1))
    for part in (slice(0, cut), slice(cut, None)):
        places = {name: None if values is None else values[:, part] for name, values in outputs.items()}
        with np.errstate(all="ignore"):
            run.run(data[:, part], data[:, part, :0], places)
    same(run.state, state, "state")
    for name in names:
        if outputs[name] is not None:
            same(outputs[name], getattr(expected, name), name)


# ------------------------------------------------------------------------------------- banks


@dataclass(frozen=True)
class Bank:
    """A bank to be made up: kind of its test and isolation, states and residuals of each member, lengths in samples."""

    kind: str
    members: tuple[tuple[int, int], ...]
    channels: int
    window: int
    persistence: int
    release: int
    code_window: int
    dedicated: bool
    starts: bool


def _blocks(rng: np.random.Generator, rows: list[int], columns: list[int]) -> np.ndarray:
    """Return blocks of these sizes along the diagonal, zeros of either sign elsewhere."""
    out = np.where(rng.random((sum(rows), sum(columns))) < 0.5, 0.0, -0.0)
    for a, b, height, width in zip(np.cumsum(rows), np.cumsum(columns), rows, columns, strict=True):
        out[a - height : a, b - width : b] = rng.standard_normal((height, width)) / max(1.0, width) ** 0.5
    return out


def bank_specification(bank: Bank, seed: int) -> Specification:
    """Return what runs, of filters, tests and codes that are made up: of banks larger than are quickly designed."""
    rng = np.random.default_rng(seed)
    states, sizes = ([one[k] for one in bank.members] for k in (0, 1))
    n, nr, m, count = sum(states), sum(sizes), bank.channels, len(sizes)
    A, C = rng.choice([0.4, 0.6, 1.2]) * _blocks(rng, states, states), _blocks(rng, sizes, states)
    B, D = rng.standard_normal((n, m)), rng.standard_normal((nr, m))
    first = None
    if bank.starts and n:
        samples = int(rng.integers(1, 6))
        first = StartFit(samples, A, C, np.eye(nr), 0.1 * np.eye(nr), 0.1 * rng.standard_normal((n, n)))
    whitening, limits = _blocks(rng, sizes, sizes), rng.uniform(1.0, 4.0, count) * rng.choice([1.0, 6.0, 25.0])
    given = (rng.standard_normal(nr), whitening, np.array(sizes), limits, bank.persistence, bank.release)
    names = tuple(f"m{j}" for j in range(count))
    groups = int(rng.integers(1, 6))
    faults = [f"f{j}" for j in range(groups)]
    test: Any = (PeakBankTest if bank.kind == "peak" else BankTest)(*given, bank.window, "made up", names=names)
    isolation: Any = NoNames()
    if bank.kind in ("groups", "directed"):
        whole = rng.standard_normal((nr, nr)) * rng.choice([1.0, 1e160, 1e200])
        if bank.kind == "groups":
            test = GroupTest(*given, bank.window, "made up", names=names, whole=whole)
        bases = tuple(np.linalg.qr(rng.standard_normal((nr, int(rng.integers(1, min(nr, 2) + 1)))))[0] for _ in faults)
        isolation = DirectionTest(bank.code_window, tuple((name,) for name in faults), bases, ())
    elif bank.kind != "alone":
        codes = rng.random((count, groups)) < 0.4
        if bank.dedicated:
            codes = np.arange(count)[:, None] == rng.integers(0, count, groups)
        settings = Structured(window=bank.code_window, share=float(rng.choice([0.3, 0.5, 1.0])))
        settled = codes & (rng.random(codes.shape) < 0.7)
        isolation = code_test(settings, codes, faults, names, settled=None if bank.dedicated else settled)
        isolation = replace(isolation, at_once=bank.kind == "peak")
    start = np.linalg.solve(np.eye(n) - A, B) if n else B
    return Specification(
        *(A, B, C, D, start, rng.standard_normal(m), test, isolation),
        settle=int(rng.integers(0, 4)),
        max_hold=int(rng.integers(0, 12)),
        plausible=np.tile([-1e150, 1e150], (m, 1)),
        first=first,
        partial=None,
    )
